"""Flight modes, what changes them, and the target that the vehicle follows."""
