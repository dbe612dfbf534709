"""Controllers: one documented interface, one cascade, and the augmentations that make it PID, MRAC, DMRAC, L1 or INDI."""
