"""`dmrac keygen FILE`: a key for the link between onboard and offboard, or for a MAVLink link."""

import argparse
import getpass
import sys
from pathlib import Path
from typing import Final

from configs.loader import ConfigError
from protocol.keys import key_of_passphrase, write_key

EXAMPLES: Final = """examples:
  dmrac keygen link.key                      make a key that only you can read
  scp -p link.key trainer:                   both machines need the same file
  dmrac fly --set network.key_file=link.key  fly with it
  dmrac fly --set network.vehicle_key_file=vehicle.key   sign the vehicle's MAVLink with another
  dmrac keygen ground.key --passphrase       the key that MAVProxy's `signing key PASSPHRASE` makes
"""
PASSPHRASE_LEAST: Final = 8


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `dmrac keygen`."""
    parser.add_argument("file", type=Path, help="where to write it; an existing file is never replaced")
    parser.add_argument(
        "--passphrase", action="store_true", help="ask for a passphrase and keep its SHA-256, as ground stations do"
    )


def run(arguments: argparse.Namespace) -> int:
    """Write the key; the key itself is shown nowhere. Raises KeyFileError, ConfigError for a poor passphrase."""
    write_key(arguments.file, key_of_passphrase(_passphrase()) if arguments.passphrase else None)
    print(
        f"{arguments.file}: new key, readable by you only; name it on both sides: network.key_file (onboard and "
        "offboard), network.vehicle_key_file or network.ground_key_file (MAVLink)"
    )
    return 0


def _passphrase() -> str:
    """What is typed, unseen and twice, or piped in. Raises ConfigError if it is short or differs."""
    if not sys.stdin.isatty():
        typed = sys.stdin.readline().rstrip("\n")
    else:
        typed = getpass.getpass("passphrase: ")
        if getpass.getpass("once more: ") != typed:
            raise ConfigError("--passphrase: the two differ")
    if len(typed) < PASSPHRASE_LEAST:
        raise ConfigError(f"--passphrase: {len(typed)} characters, expected {PASSPHRASE_LEAST} or more")
    return typed
