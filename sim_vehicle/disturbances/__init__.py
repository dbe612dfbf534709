"""Disturbances that a scenario can list."""
