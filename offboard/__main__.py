"""`python -m offboard`: run this process alone."""

import sys

from runtime.entry import main

if __name__ == "__main__":
    sys.exit(main("offboard", "Learn features from a vehicle's samples and relay its pose."))
