"""Files of a process: written completely or not at all, or line by line."""

import errno
import json
import os
import sys
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO, Final

from runtime.errors import StartError

PART: Final = ".part"
"""Behind the name of a file that is being written."""
_NO_SPACE: Final = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def write_atomically(path: Path, content: bytes) -> None:
    """Write a file so that a reader finds the old or the new content, even after a power cut in between.

    Raises
    ------
    OSError
        Names the file. Nothing of the new content is left.
    """
    beside = path.with_name(path.name + PART)
    try:
        with beside.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        beside.replace(path)
        sync_folder(path.parent)
    except OSError as error:
        with suppress(OSError):
            beside.unlink(missing_ok=True)
        raise OSError(error.errno, error.strerror, str(path)) from None


def append_json(file: BinaryIO, entry: Mapping[str, Any]) -> None:
    """Append one line of JSON to a file that is open for bytes; it is on the disk when this returns. Raises OSError."""
    file.write(json.dumps(entry).encode() + b"\n")
    file.flush()
    os.fsync(file.fileno())


def sync_folder(folder: Path) -> None:
    """Bring the names of a folder's files to the disk: without it a power cut may undo a rename. Raises OSError."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def no_space(error: OSError) -> bool:
    """Whether the disk, or this user's share of it, is full."""
    return error.errno in _NO_SPACE


def write_json(path: Path, values: dict[str, Any]) -> None:
    """Write a summary atomically; values may be numpy scalars and arrays. Raises OSError."""
    write_atomically(path, (json.dumps(values, indent=2, default=plain_value) + "\n").encode())


def write_last(path: Path, values: dict[str, Any]) -> bool:
    """Write the summary of a process that ends; False, with a line on stderr, if the disk does not take it."""
    try:
        write_json(path, values)
    except OSError as error:
        print(f"{path}: cannot be written: {error.strerror}", file=sys.stderr, flush=True)
        return False
    return True


def make_folder(path: Path) -> None:
    """Make the output folder of a process.

    Raises
    ------
    StartError
        If it cannot be made, or is not writable.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StartError(f"--out {path}: cannot be made: {error.strerror}") from None
    if not os.access(path, os.W_OK):
        raise StartError(f"--out {path}: is not writable")


def plain_value(value: Any) -> Any:
    """A numpy scalar or array as JSON can write it; anything else as text."""
    return value.tolist() if hasattr(value, "tolist") else str(value)
