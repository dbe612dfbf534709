"""Shows the status of a lockstep flight while it is computed, as `live_status` does for a flight in real time.

It only reads the results of the ticks, so it does not change the flight.
"""

import threading
import time
from types import TracebackType
from typing import Any, Final, Self

import numpy as np
from rich.console import Console

from experiments.flights.live_status import LiveStatus
from onboard.flight.supervisor import FlightMode
from onboard.record.tick import OFFSET
from runtime.waiting import LONG_S
from sim_vehicle.link.radio import DIRECTIONS, Radio
from sim_vehicle.lockstep import TickResult

READ_PERIOD_S: Final = 0.25
_TARGET: Final = slice(OFFSET["target_n"], OFFSET["target_n"] + 3)


class LockstepStatus:
    """Observer of a lockstep flight that shows its status. A context manager.

    Parameters
    ----------
    console: a terminal gets a table that is redrawn, any other output a line every two seconds.
    duration_s: s, of the whole flight.
    """

    def __init__(self, console: Console, duration_s: float) -> None:
        self._live = LiveStatus(console, with_events=console.is_terminal)
        self._duration_s = duration_s
        self._started_s = self._next_s = time.monotonic()
        self._first = threading.Timer(LONG_S, self._tell_start, (console,))
        self._first.daemon = True
        self._shown = False

    def __call__(self, result: TickResult) -> None:
        """Receive one tick."""
        if not self._shown:
            self._shown = True
            self._first.cancel()
            self._started_s = time.monotonic()
        for process, output in (("onboard", result.onboard), ("offboard", result.offboard)):
            for _, text in output.events if output is not None else ():
                self._live({"process": process, "kind": "event", "text": text})
        now_s = time.monotonic()
        if now_s >= self._next_s:
            self._next_s = now_s + READ_PERIOD_S
            self._live(_onboard_status(result))
            self._live(self._sim_status(result, now_s))

    def _sim_status(self, result: TickResult, now_s: float) -> dict[str, Any]:
        time_s = result.now_ns * 1e-9
        pace = time_s / max(now_s - self._started_s, 1e-3)
        progress = f"{time_s:.1f} of {self._duration_s:.1f} s, {pace:.2g} times real time"
        return {"process": "sim", "kind": "status", "progress": progress, "link": _link(result.radio)}

    def _tell_start(self, console: Console) -> None:
        if not console.is_terminal:
            console.print("starting: the first start compiles the simulated vehicle", highlight=False, soft_wrap=True)

    def __enter__(self) -> Self:
        self._live.__enter__()
        self._first.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._first.cancel()
        self._live.__exit__(kind, error, trace)


def _onboard_status(result: TickResult) -> dict[str, Any]:
    tick = result.onboard.tick
    return {
        "process": "onboard",
        "kind": "status",
        "mode": FlightMode(int(tick[OFFSET["mode"]])).name,
        "tracking_error_m": float(np.linalg.norm(result.truth[:3] - tick[_TARGET])),
        "feature_version": int(tick[OFFSET["feature_version"]]),
        "feature_age_s": float(tick[OFFSET["feature_age"]]),
    }


def _link(radio: Radio) -> dict[str, dict[str, int]]:
    counts = {direction: radio.counts(direction) for direction in DIRECTIONS}
    return {direction: {"sent": one.sent, "lost": one.lost} for direction, one in counts.items()}
