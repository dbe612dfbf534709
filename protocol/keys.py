"""Key files. The only module of this package that uses the file system.

A key file holds 64 hexadecimal digits (32 bytes). Only its owner may read it, like a private SSH key.
"""

import hashlib
import os
import re
import secrets
import stat
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple

from configs.loader import ConfigError
from protocol.authentication import KEY_BYTES

_FILE_MAX_BYTES: Final = 256


class KeyFileError(ConfigError):
    """A key file that cannot be used. The message names the file and the remedy, never its content."""


class LinkKeys(NamedTuple):
    """The keys of onboard's three links; None for a link without a key."""

    offboard: bytes | None
    """Shared with offboard: every datagram carries a MAC."""
    vehicle: bytes | None
    """Shared with the vehicle's bridge: MAVLink 2 signing."""
    ground: bytes | None
    """Shared with the ground station: MAVLink 2 signing."""

    @property
    def any(self) -> bool:
        """Whether at least one link has a key."""
        return any(key is not None for key in self)


def load_keys(offboard: str | None, vehicle: str | None, ground: str | None) -> LinkKeys:
    """The keys in the given files; None for no file. Raises KeyFileError."""
    return LinkKeys(load_key(offboard), load_key(vehicle), load_key(ground))


def key_of_passphrase(passphrase: str) -> bytes:
    """The key that MAVLink ground stations derive from a passphrase: its SHA-256."""
    return hashlib.sha256(passphrase.encode()).digest()


def write_key(path: Path, key: bytes | None = None) -> None:
    """Write a key (by default a new random one) to a new file that only its owner can read.

    Raises
    ------
    KeyFileError
        If the file exists or cannot be written.
    """
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError:
        raise KeyFileError(f"{path}: exists already; choose another name or remove it yourself") from None
    except OSError as error:
        raise KeyFileError(f"{path}: cannot be written: {error.strerror}") from None
    with os.fdopen(descriptor, "w", encoding="ascii") as file:
        file.write((secrets.token_bytes(KEY_BYTES) if key is None else key).hex() + "\n")


def load_key(key_file: str | None) -> bytes | None:
    """The key in a file; None for no file. Raises KeyFileError."""
    return None if key_file is None else read_key(Path(key_file))


def read_key(path: Path) -> bytes:
    """The key in a file.

    Raises
    ------
    KeyFileError
        If the file cannot be read, is accessible to others than its owner, or does not hold a key.
    """
    try:
        # O_NONBLOCK: opening a named pipe must not block
        with open(path, "rb", opener=lambda name, flags: os.open(name, flags | os.O_NONBLOCK)) as file:
            return _read_checked(path, file)
    except OSError as error:
        raise KeyFileError(f"{path}: cannot be read: {error.strerror}") from None


def _read_checked(path: Path, file: BinaryIO) -> bytes:
    status = os.fstat(file.fileno())  # of the open file, which cannot be exchanged any more
    if not stat.S_ISREG(status.st_mode):
        raise KeyFileError(f"{path}: is not a file")
    if status.st_mode & (stat.S_IRWXG | stat.S_IRWXO):
        mode = stat.S_IMODE(status.st_mode)
        raise KeyFileError(f"{path}: mode {mode:03o} lets others access the key; run: chmod 600 {path}")
    text = file.read(_FILE_MAX_BYTES).strip()
    if not re.fullmatch(rb"[0-9a-fA-F]{%d}" % (2 * KEY_BYTES), text):
        raise KeyFileError(f"{path}: does not hold a key of {2 * KEY_BYTES} hexadecimal digits")
    return bytes.fromhex(text.decode("ascii"))
