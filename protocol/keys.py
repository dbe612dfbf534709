"""Key files: the one place of this package that touches the file system, called by the socket shells only.

A key file holds 64 hexadecimal digits (32 bytes) and belongs to its owner alone, like a private SSH key.
"""

import os
import re
import secrets
import stat
from pathlib import Path
from typing import BinaryIO, Final

from configs.loader import ConfigError
from protocol.authentication import KEY_BYTES

_FILE_MAX_BYTES: Final = 256


class KeyFileError(ConfigError):
    """A key file that cannot be used. The message names the file and what to do, never what stands in it."""


def write_key(path: Path) -> None:
    """Makes a new random key in a file that only its owner can read; an existing file is never replaced.

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
        file.write(secrets.token_hex(KEY_BYTES) + "\n")


def load_key(key_file: str | None) -> bytes | None:
    """The key that the configuration names; None where it names no file. Raises KeyFileError."""
    return None if key_file is None else read_key(Path(key_file))


def read_key(path: Path) -> bytes:
    """The key in a file.

    Raises
    ------
    KeyFileError
        If the file cannot be read, anyone but its owner may touch it, or it does not hold a key.
    """
    try:
        with open(path, "rb", opener=_open_without_waiting) as file:
            return _read_checked(path, file)
    except OSError as error:
        raise KeyFileError(f"{path}: cannot be read: {error.strerror}") from None


def _open_without_waiting(path: str, flags: int) -> int:
    return os.open(path, flags | os.O_NONBLOCK)  # a named pipe must not hold us up


def _read_checked(path: Path, file: BinaryIO) -> bytes:
    status = os.fstat(file.fileno())  # of the open file, which nobody can exchange any more
    if not stat.S_ISREG(status.st_mode):
        raise KeyFileError(f"{path}: is not a file")
    if status.st_mode & (stat.S_IRWXG | stat.S_IRWXO):
        mode = stat.S_IMODE(status.st_mode)
        raise KeyFileError(f"{path}: mode {mode:03o} lets others at the key; run: chmod 600 {path}")
    text = file.read(_FILE_MAX_BYTES).strip()
    if not re.fullmatch(rb"[0-9a-fA-F]{%d}" % (2 * KEY_BYTES), text):
        raise KeyFileError(f"{path}: does not hold a key of {2 * KEY_BYTES} hexadecimal digits")
    return bytes.fromhex(text.decode("ascii"))
