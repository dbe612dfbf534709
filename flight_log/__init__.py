"""The flight record: write, read, view and report what happened in a flight."""
