"""The folder of a flight's record: made before the flight, and taken away again when none took place."""

import time
from collections.abc import Collection
from pathlib import Path
from typing import Final

from configs.loader import ConfigError

OWN_FILES: Final = ("config.yaml", "*.mcap", "*_summary.json", "*.npz", "*_errors.txt")
"""What `fly` and the processes of a flight write before it has begun."""


def make_folder(out: Path | None, scenario: str) -> Path:
    """A new folder for the record: `out`, or flights/<time>_<scenario>.

    Raises
    ------
    ConfigError
        If it cannot be made, or holds another flight already.
    """
    folder = out or Path("flights") / f"{time.strftime('%Y-%m-%d_%H%M%S')}_{scenario}"
    number = 1
    while out is None and folder.exists():
        number += 1
        folder = folder.with_name(f"{time.strftime('%Y-%m-%d_%H%M%S')}_{scenario}_{number}")
    if (folder / "summary.json").exists():
        raise ConfigError(f"--out {folder}: holds a flight already; choose another folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"--out {folder}: cannot be made: {error.strerror}") from None
    return folder


def clear_folder(folder: Path, kept: Collection[Path] = ()) -> str:
    """Takes away what a flight that did not start has left, but for long reports of errors.

    Parameters
    ----------
    kept: files that were there before.

    Returns
    -------
    A remark on where the reports are; "" where there are none.
    """
    reports = [path for path in sorted(folder.glob("*_errors.txt")) if _lines(path) > 1]
    for pattern in OWN_FILES:
        for path in folder.glob(pattern):
            if path not in reports and path not in kept:
                path.unlink()
    if not any(folder.iterdir()):
        folder.rmdir()
    return f"; all it said is in {', '.join(map(str, reports))}" if reports else ""


def _lines(path: Path) -> int:
    return len(path.read_text(encoding="utf-8", errors="replace").splitlines())
