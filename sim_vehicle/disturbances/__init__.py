"""Disturbances that a scenario can list: one file per kind, found by its name."""
