"""Samples, labels, the buffer, and experience files."""
