"""`dmrac keygen FILE`: a new key for the link between onboard and offboard."""

import argparse
from pathlib import Path
from typing import Final

from protocol.keys import write_key

EXAMPLES: Final = """examples:
  dmrac keygen link.key                      make a key that only you can read
  scp -p link.key trainer:                   both machines need the same file
  dmrac fly --set network.key_file=link.key  fly with it"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `dmrac keygen`."""
    parser.add_argument("file", type=Path, help="where to write it; an existing file is never replaced")


def run(arguments: argparse.Namespace) -> int:
    """Write the key; the key itself is shown nowhere. Raises KeyFileError."""
    write_key(arguments.file)
    print(f"{arguments.file}: new key, readable by you only; name it as network.key_file on both sides")
    return 0
