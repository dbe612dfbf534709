"""`dmrac keygen FILE`: makes a key for the link between onboard and offboard, or for a MAVLink link."""

import argparse
import getpass
import sys
from pathlib import Path
from typing import Final

from configs.loader import ConfigError
from protocol.keys import key_of_passphrase, write_key

EXAMPLES: Final = """examples:
  dmrac keygen link.key                      make a key file that only you can read
  scp -p link.key trainer:                   both machines need the same file
  dmrac fly --set network.key_file=link.key  fly with it
  dmrac fly --set network.vehicle_key_file=vehicle.key   sign the vehicle's MAVLink with another key
  dmrac keygen ground.key --passphrase       the key that MAVProxy's `signing key PASSPHRASE` makes
"""
PASSPHRASE_LEAST: Final = 8


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the subcommand."""
    parser.add_argument("file", type=Path, help="file to write; an existing file is never replaced")
    parser.add_argument(
        "--passphrase",
        action="store_true",
        help="ask for a passphrase and use its SHA-256 as the key, as ground stations do",
    )


def run(arguments: argparse.Namespace) -> int:
    """Write the key file; the key is not printed. Raises KeyFileError, or ConfigError for an unusable passphrase."""
    write_key(arguments.file, key_of_passphrase(_passphrase()) if arguments.passphrase else None)
    print(
        f"{arguments.file}: new key, readable only by you; set it on both sides: network.key_file (onboard and "
        "offboard), network.vehicle_key_file, ground_key_file or capture_key_file (MAVLink)"
    )
    return 0


def _passphrase() -> str:
    """The passphrase, typed twice without echo, or piped in. Raises ConfigError if it is too short or differs."""
    if not sys.stdin.isatty():
        typed = sys.stdin.readline().rstrip("\n")
    else:
        typed = getpass.getpass("passphrase: ")
        if getpass.getpass("repeat it: ") != typed:
            raise ConfigError("--passphrase: the two passphrases differ")
    if len(typed) < PASSPHRASE_LEAST:
        raise ConfigError(f"--passphrase: {len(typed)} characters, expected {PASSPHRASE_LEAST} or more")
    return typed
