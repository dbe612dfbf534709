"""Files of a process, written completely or not at all."""

import json
import os
from pathlib import Path
from typing import Any

from runtime.errors import StartError


def write_atomically(path: Path, content: bytes) -> None:
    """Write a file so that a reader finds the old or the new content, even after a crash in between. Raises OSError."""
    beside = path.with_name(path.name + ".part")
    with beside.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    beside.replace(path)


def write_json(path: Path, values: dict[str, Any]) -> None:
    """Write a summary atomically; values may be numpy scalars and arrays. Raises OSError."""
    write_atomically(path, (json.dumps(values, indent=2, default=plain_value) + "\n").encode())


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
