"""`python -m sim_vehicle`: run this process alone."""

import sys

from runtime.entry import main

if __name__ == "__main__":
    sys.exit(main("sim_vehicle", "Simulate a Mambo, its motion capture and its radio, in real time."))
