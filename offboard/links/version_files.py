"""The files of the versions that were sent: the newest ones of a flight, one file each."""

import threading
from collections import deque
from pathlib import Path

from runtime.files import write_atomically


class VersionFiles:
    """Writes `features_N.npz`, and deletes the oldest of this process when there are more than `kept`.

    The background thread writes in flight. At the end the main thread writes what is left: the background may be in a
    round of training, which is not waited for.
    """

    def __init__(self, folder: Path, kept: int) -> None:
        self._folder = folder
        self._kept = kept
        self._waiting: deque[tuple[int, bytes]] = deque()
        self._written: deque[Path] = deque()
        self._lock = threading.Lock()

    def put(self, version: int, content: bytes) -> None:
        """Accept a version; `write_waiting` writes it."""
        self._waiting.append((version, content))

    def write_waiting(self) -> None:
        """Write what waits, and delete what is too old. Raises OSError; what could not be written is dropped."""
        with self._lock:
            while self._waiting:
                version, content = self._waiting.popleft()
                file = self._folder / f"features_{version}.npz"
                write_atomically(file, content)
                self._written.append(file)
                while len(self._written) > self._kept:
                    self._written.popleft().unlink(missing_ok=True)
