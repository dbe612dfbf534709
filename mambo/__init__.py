"""The flight core on the Mambo: library, configuration image, checks and a stand-in for the firmware."""
