"""`python -m offboard`: run this process alone."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported: its threads only cost here
os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import sys

from offboard.command import add_arguments, run


def main() -> int:
    """Parse the command line and run the process."""
    parser = argparse.ArgumentParser(
        prog="python -m offboard", description="Learn features from a vehicle's samples and relay its pose."
    )
    add_arguments(parser)
    return run(parser.parse_args())


if __name__ == "__main__":
    sys.exit(main())
