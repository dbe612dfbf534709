"""Follows a flight while it is flown, by reading the growing log files of its processes.

The processes are not involved. A chunk reaches the files within the writers' flush period, so the scenes are about
half a second old.
"""

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

from flight_log.log_file import LogTail
from flight_log.reader import TICK_TOPIC, Flight, FlightError
from flight_log.scene import Scene, build_scene

POLL_PERIOD_S: Final = 0.3
START_LIMIT_S: Final = 60.0
FIRST_TICK_LIMIT_S: Final = 10.0
"""Longest wait for onboard's first tick, t = 0, after another process has logged its first record."""
END_FILE: Final = "summary.json"
"""Written last: the flight is finished when its folder contains it."""


class FlightTail:
    """A growing flight folder: `read` returns the scene of what was logged since the call before.

    Parameters
    ----------
    first_tick_limit_s: longest wait for onboard's first tick, from the first record of any process.
    clock: time in s.
    """

    def __init__(
        self, folder: Path, first_tick_limit_s: float = FIRST_TICK_LIMIT_S, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._folder = folder
        self._first_tick_limit_s = first_tick_limit_s
        self._clock = clock
        self._tails: dict[Path, LogTail] = {}
        self._waiting_since_s: float | None = None
        self._start_ns: int | None = None

    def read(self, finished: bool = False) -> Scene | None:
        """The scene of the new records; None if there are none. A `finished` flight is not waited for.

        Raises FlightError for a file that is not a flight log.
        """
        for path in sorted(self._folder.glob("*.mcap")):
            self._tails.setdefault(path, LogTail(path))
        logs = tuple(log for tail in self._tails.values() if (log := tail.read()).record_count)
        if not logs:
            return None
        flight = Flight(self._folder, logs)
        if self._start_ns is None:
            if TICK_TOPIC not in flight and not finished and self._may_wait():
                self._tails.clear()  # read again from the beginning once t = 0 is known
                return None
            self._start_ns = flight.start_ns
        return build_scene(flight, self._start_ns)

    def _may_wait(self) -> bool:
        now_s = self._clock()
        if self._waiting_since_s is None:
            self._waiting_since_s = now_s
        return now_s - self._waiting_since_s < self._first_tick_limit_s


def follow(folder: Path, wanted: Callable[[], bool], start_limit_s: float = START_LIMIT_S) -> Iterator[Scene]:
    """The scenes of a flight as they are logged, until it is finished or no longer `wanted`.

    Raises
    ------
    FlightError
        If no log appears within `start_limit_s`, or one is not readable.
    """
    tail, deadline, seen = FlightTail(folder), time.monotonic() + start_limit_s, False
    while wanted():
        finished = (folder / END_FILE).exists()  # checked first: everything written before END_FILE is then read below
        scene = tail.read(finished)
        if scene is not None:
            seen = True
            yield scene
        if finished:
            return
        if not seen and time.monotonic() > deadline:
            raise FlightError(f"{folder}: no flight log appeared within {start_limit_s:.0f} s")
        time.sleep(POLL_PERIOD_S)
