"""Status lines of a process on standard output: as JSON for a supervising program, or as text. Writing never waits."""

import json
import os
import stat
import sys
from typing import Any, Final

from runtime.files import plain_value

STATUS_PERIOD_NS: Final = 333_000_000
PLAIN_EVERY: Final = 6
"""As text, only every sixth status is written: one in two seconds."""


class StatusLines:
    """Writes status and events to standard output; lines are dropped if the reader does not keep up.

    Parameters
    ----------
    process: "onboard", "offboard" or "sim".
    as_json: one JSON object per line; non-blocking if standard output is a pipe.
    insecure: the links without a key that leave this machine, which every status then names.
    """

    def __init__(self, process: str, as_json: bool, insecure: str = "") -> None:
        self._process = process
        self._standing = {"INSECURE": insecure} if insecure else {}
        self._json = as_json
        self._descriptor = sys.stdout.fileno()
        self._next_ns = 0
        self._count = 0
        self.dropped = 0
        if as_json and stat.S_ISFIFO(os.fstat(self._descriptor).st_mode):
            os.set_blocking(self._descriptor, False)

    def due(self, now_ns: int) -> bool:
        """Whether to write a status now; at most three times a second."""
        if now_ns < self._next_ns:
            return False
        self._next_ns = now_ns + STATUS_PERIOD_NS
        return True

    def write(self, values: dict[str, Any]) -> None:
        """Write the current values."""
        self._count += 1
        values = {**self._standing, **values}
        if self._json:
            self._put({"process": self._process, "kind": "status", **values})
        elif self._count % PLAIN_EVERY == 1:
            words = "  ".join(f"{name} {_short(value)}" for name, value in values.items())
            self._line(f"{self._process}: {words}")

    def report(self, text: str) -> None:
        """Write an event."""
        self._event("event", text)

    def fault(self, text: str) -> None:
        """Write that the record of the flight is incomplete, and why."""
        self._event("fault", text)

    def _event(self, kind: str, text: str) -> None:
        if self._json:
            self._put({"process": self._process, "kind": kind, "text": text})
        else:
            self._line(f"{self._process}: {text}")

    def _put(self, entry: dict[str, Any]) -> None:
        self._line(json.dumps(entry, default=plain_value))

    def _line(self, line: str) -> None:
        try:
            os.write(self._descriptor, line.encode() + b"\n")  # shorter than PIPE_BUF: written completely or not at all
        except OSError:
            self.dropped += 1


def _short(value: Any) -> str:
    if isinstance(value, dict):
        return " ".join(f"{name} {_short(below)}" for name, below in value.items())
    return f"{value:.3g}" if isinstance(value, float) else str(value)
