"""Memories of earlier flights: made from logs, and put into the folders of flights."""
