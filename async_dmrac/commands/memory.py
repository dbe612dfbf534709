"""`dmrac memory show FOLDER`: what a memory holds."""

import argparse
from pathlib import Path

from async_dmrac.commands.output import add_json_option, print_json
from experiments.memory.description import as_json, describe
from offboard.memory.folder import open_memory

DESCRIPTION = "Check a memory and show what it holds: networks, prior and conditions (docs/memory.md)."
EXAMPLES = """examples:
  dmrac memory show memory
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the actions of the subcommand."""
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    show = actions.add_parser("show", help="check a memory and show what it holds")
    show.add_argument("folder", type=Path, metavar="FOLDER", help="of the memory")
    add_json_option(show, "what the memory holds")


def run(arguments: argparse.Namespace) -> int:
    """Show the memory; returns 0. Raises ConfigError if there is none, or it is damaged."""
    memory = open_memory(arguments.folder)
    if arguments.json:
        print_json(as_json(arguments.folder, memory))
    else:
        print("\n".join(describe(arguments.folder, memory)))
    return 0
