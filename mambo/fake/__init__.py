"""The stand-in for the drone's firmware, and the onboard core that flies through it in lockstep."""
