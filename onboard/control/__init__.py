"""Controllers: one documented interface, one cascade, and what makes it PID, MRAC, DMRAC, L1 or INDI."""
