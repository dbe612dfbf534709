"""The flight core on the Mambo's own processor: library, configuration image, checks and a stand-in for the firmware."""
