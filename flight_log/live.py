"""A flight while it is flown, from the log files its processes write: nothing is asked of the processes themselves.

A chunk reaches the files within the writers' flush period, so what is shown is about half a second old.
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
PATIENCE_S: Final = 10.0
"""So long onboard's first tick, the zero of the time line, is waited for once another process has logged."""
END_FILE: Final = "summary.json"
"""Written last: a flight folder that has it is finished."""


class FlightTail:
    """A growing flight folder: `read` gives the scene of what has come since the call before.

    Parameters
    ----------
    patience_s: onboard's first tick is waited for so long, counted from the first record of anybody.
    clock: s.
    """

    def __init__(
        self, folder: Path, patience_s: float = PATIENCE_S, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._folder = folder
        self._patience_s = patience_s
        self._clock = clock
        self._tails: dict[Path, LogTail] = {}
        self._waiting_since_s: float | None = None
        self._start_ns: int | None = None

    def read(self, finished: bool = False) -> Scene | None:
        """What is new; None when nothing is. What is `finished` is not waited for.

        Raises FlightError for a file that is no flight log.
        """
        for path in sorted(self._folder.glob("*.mcap")):
            self._tails.setdefault(path, LogTail(path))
        logs = tuple(log for tail in self._tails.values() if (log := tail.read()).record_count)
        if not logs:
            return None
        flight = Flight(self._folder, logs)
        if self._start_ns is None:
            if TICK_TOPIC not in flight and not finished and self._patient():
                self._tails.clear()  # read again from their beginning, when there is a zero to count from
                return None
            self._start_ns = flight.start_ns
        return build_scene(flight, self._start_ns)

    def _patient(self) -> bool:
        now_s = self._clock()
        if self._waiting_since_s is None:
            self._waiting_since_s = now_s
        return now_s - self._waiting_since_s < self._patience_s


def follow(folder: Path, wanted: Callable[[], bool], start_limit_s: float = START_LIMIT_S) -> Iterator[Scene]:
    """The scenes of a flight as they come, until it is finished or no longer `wanted`.

    Raises
    ------
    FlightError
        If no log appears in time, or one is not readable.
    """
    tail, deadline, seen = FlightTail(folder), time.monotonic() + start_limit_s, False
    while wanted():
        finished = (folder / END_FILE).exists()  # asked first: what was written before it is then read below
        scene = tail.read(finished)
        if scene is not None:
            seen = True
            yield scene
        if finished:
            return
        if not seen and time.monotonic() > deadline:
            raise FlightError(f"{folder}: no flight log appeared within {start_limit_s:.0f} s")
        time.sleep(POLL_PERIOD_S)
