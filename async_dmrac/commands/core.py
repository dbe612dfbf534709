"""`dmrac core build`: builds the onboard core in C, or says why it cannot be built here."""

import argparse
import ctypes
from typing import Final

from async_dmrac.commands.shared import plain_console
from configs.loader import ConfigError
from onboard.cores import PRECISIONS

EXAMPLES: Final = """examples:
  dmrac core build                      build the C core now, not at the first flight
  CC=clang dmrac core build             with another compiler
  dmrac fly --lockstep --core c         fly with it
"""
ORIGINS: Final = {"wheel": "came with the installation", "cache": "was built before", "built": "built now"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `dmrac core`."""
    parser.add_argument("action", choices=("build",), help="build: compile and load the core, unless that is done")
    parser.add_argument(
        "--precision", choices=PRECISIONS, help="of its numbers (default: both; flights use double, replays either)"
    )


def run(arguments: argparse.Namespace) -> int:
    """Build, load and print; return 0. Raises ConfigError with what to do if no compiler works."""
    from onboard.c.compile import BuildError, Variant, compiler
    from onboard.c.config_table import TableError
    from onboard.c.library import load, ready_library

    console = plain_console()
    for precision in (arguments.precision,) if arguments.precision else PRECISIONS:
        variant = Variant(precision)
        try:
            built = ready_library(variant)
            core = load(variant)
            by = f" by {' '.join(compiler())}" if built.origin == "built" else ""
        except (BuildError, TableError) as error:
            raise ConfigError(str(error)) from None
        size = ctypes.sizeof(core.Core) / 1e6
        console.print(f"{precision:6} {ORIGINS[built.origin]}{by}: {built.path}, {size:.1f} MB of state for a vehicle")
    return 0
