"""Gain, phase and delay margins of the control loops, measured in lockstep and predicted by a linear model."""
