"""Entry point of `python -m onboard`, `python -m offboard` and `python -m sim_vehicle`."""

import argparse
import os
import sys
from importlib import import_module


def main(package: str, description: str) -> int:
    """Parse the command line and run the process of a package; returns its exit status."""
    # before the import of numpy and torch: their threads cost time here
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    command = import_module(f"{package}.command")
    parser = argparse.ArgumentParser(prog=f"python -m {package}", description=description)
    command.add_arguments(parser)
    try:
        status: int = command.run(parser.parse_args())
    except OSError as error:
        if error.filename is None:
            raise
        print(f"{error.filename}: {error.strerror}", file=sys.stderr)
        return 2
    return status
