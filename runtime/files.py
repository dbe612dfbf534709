"""Files of a process: written whole or not at all."""

import json
import os
from pathlib import Path
from typing import Any

from runtime.errors import StartError


def write_atomically(path: Path, content: bytes) -> None:
    """Write a file so that a reader, or a crash in the middle, finds the old or the new one, never half."""
    beside = path.with_name(path.name + ".part")
    with beside.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    beside.replace(path)


def write_json(path: Path, values: dict[str, Any]) -> None:
    """Write a summary, numpy numbers included, atomically."""
    write_atomically(path, (json.dumps(values, indent=2, default=_plain) + "\n").encode())


def make_folder(path: Path) -> None:
    """Make a process's output folder.

    Raises
    ------
    StartError
        If it cannot be made or written to.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StartError(f"--out {path}: cannot be made: {error.strerror}") from None
    if not os.access(path, os.W_OK):
        raise StartError(f"--out {path}: may not be written to")


def _plain(value: Any) -> Any:
    return value.tolist() if hasattr(value, "tolist") else str(value)
