"""From sensor readings to the vehicle's state."""
