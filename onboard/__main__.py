"""`python -m onboard`: run this process alone."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported: its threads only cost here
os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import sys

from onboard.command import add_arguments, run


def main() -> int:
    """Parse the command line and run the process."""
    parser = argparse.ArgumentParser(prog="python -m onboard", description="Fly a vehicle: the 200 Hz loop.")
    add_arguments(parser)
    return run(parser.parse_args())


if __name__ == "__main__":
    sys.exit(main())
