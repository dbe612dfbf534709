"""How each controller estimates the disturbance Delta of a channel: one file per law."""
