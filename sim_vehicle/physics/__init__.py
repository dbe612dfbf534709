"""Rigid body, motors, battery and floor: the compiled step."""
