"""The folder of a flight's record: made before the flight, and removed if the flight does not start."""

import time
from collections.abc import Collection
from pathlib import Path
from typing import Final

from configs.loader import ConfigError

OWN_FILES: Final = ("config.yaml", "*.mcap", "*_summary.json", "*.npz", "*_errors.txt")
"""Files that `fly` and the processes write before the flight begins."""


def make_folder(out: Path | None, scenario: str) -> Path:
    """Make a new folder for the record: `out`, or flights/<time>_<scenario>.

    Raises
    ------
    ConfigError
        If it cannot be made, or already contains a flight.
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


def clear_folder(folder: Path, earlier: Collection[Path] = ()) -> str:
    """Remove the files of a flight that did not start, except long error reports.

    Parameters
    ----------
    earlier: files that were there before.

    Returns
    -------
    A text on where the error reports are; "" if there are none.
    """
    reports = [path for path in sorted(folder.glob("*_errors.txt")) if _lines(path) > 1]
    for pattern in OWN_FILES:
        for path in folder.glob(pattern):
            if path not in reports and path not in earlier:
                path.unlink()
    if not any(folder.iterdir()):
        folder.rmdir()
    return f"; its full output is in {', '.join(map(str, reports))}" if reports else ""


def _lines(path: Path) -> int:
    return len(path.read_text(encoding="utf-8", errors="replace").splitlines())
