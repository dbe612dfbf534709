"""Measurements of computing time: the onboard step, the loop, the simulated vehicle and the trainer."""
