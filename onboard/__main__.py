"""`python -m onboard`: run this process alone."""

import sys

from runtime.entry import main

if __name__ == "__main__":
    sys.exit(main("onboard", "Fly a vehicle: the 200 Hz loop."))
