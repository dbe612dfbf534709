"""The simulated Parrot Mambo, its world, its sensors and its lossy radio."""
