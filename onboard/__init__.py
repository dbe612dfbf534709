"""The 200 Hz flight process: senses, adapts and commands the motors. Never imports torch."""
