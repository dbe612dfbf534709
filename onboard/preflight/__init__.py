"""Checks of a real vehicle before it may fly."""
