"""The simulated world: the interface of a disturbance, how its class is found, and the disturbances of one flight."""
