"""Shows the status of a running flight: a live table in a terminal, plain lines elsewhere."""

import time
from collections import deque
from collections.abc import Callable
from types import TracebackType
from typing import Any, Final, Self

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

PLAIN_PERIOD_S: Final = 2.0
DRAWING_PERIOD_S: Final = 0.25
SILENT_S: Final = 2.0
"""Values of a process that has reported nothing for so long are not shown."""
EVENTS_SHOWN: Final = 6
EVENT_KINDS: Final = ("event", "fault")


class FlightStatus:
    """The newest values that each process reported, and the latest events. Prints nothing."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._values: dict[str, dict[str, Any]] = {}
        self._received_s: dict[str, float] = {}
        self.events: deque[str] = deque(maxlen=EVENTS_SHOWN)

    def receive(self, entry: dict[str, Any]) -> None:
        """Store one line that a process reported."""
        process = str(entry.get("process", ""))
        if entry.get("kind") in EVENT_KINDS:
            self.events.append(f"{process}: {entry.get('text', '')}")
        elif entry.get("kind") == "status":
            self._values[process] = entry
            self._received_s[process] = self._clock()

    def of(self, process: str) -> dict[str, Any]:
        """Return the newest values of a process; empty if it has reported nothing for SILENT_S."""
        silent_s = self._clock() - self._received_s.get(process, -SILENT_S)
        return self._values[process] if silent_s < SILENT_S else {}

    def rows(self) -> list[tuple[str, str]]:
        """Return (name, value) of everything that is shown."""
        onboard, offboard, sim = (self.of(name) for name in ("onboard", "offboard", "sim"))
        rows = [
            ("time", sim.get("progress") or _number(sim.get("time_s"), "s", 1)),
            ("mode", _mode(onboard)),
            ("tracking error", _number(onboard.get("tracking_error_m"), "m", 3)),
            ("features", _features(onboard)),
            ("link loss", f"up {_loss(sim, 'up')}, down {_loss(sim, 'down')}"),
        ]
        if "progress" in sim:  # lockstep: no tick can be missed, and the trainer is no process that reports
            return rows
        return [*rows, ("missed ticks", str(onboard.get("missed_ticks", "-"))), ("held-out loss", _losses(offboard))]

    def line(self) -> str:
        """Return everything in one line."""
        return "  ".join(f"{name} {value}" for name, value in self.rows())

    def table(self) -> Group:
        """Return everything as a table, with the latest events below."""
        table = Table(show_header=False, box=None, pad_edge=False)
        for name, value in self.rows():
            table.add_row(Text(name, style="dim"), value)
        return Group(table, *(Text(event, style="dim", no_wrap=True, overflow="ellipsis") for event in self.events))


class LiveStatus:
    """Shows the status of a running flight. A context manager.

    Parameters
    ----------
    console: a terminal gets a table that is redrawn, any other output a line every two seconds.
    with_events: whether to show events.
    """

    def __init__(self, console: Console, with_events: bool = True) -> None:
        self.status = FlightStatus()
        self._console = console
        self._with_events = with_events
        self._live = Live(console=console, auto_refresh=False, transient=True) if console.is_terminal else None
        self._next_plain = 0.0
        self._next_drawing = 0.0

    def __enter__(self) -> Self:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._next_drawing = 0.0
            self._redraw()
            self._live.stop()

    def __call__(self, entry: dict[str, Any]) -> None:
        """Receive one reported line and update the display."""
        if entry.get("kind") == "event" and not self._with_events:
            return
        self.status.receive(entry)
        if self._live is not None:
            self._redraw()
        elif entry.get("kind") in EVENT_KINDS:
            self._print(f"{entry.get('process')}: {entry.get('text')}")
        elif time.monotonic() >= self._next_plain and self.status.of("sim"):
            self._next_plain = time.monotonic() + PLAIN_PERIOD_S
            self._print(self.status.line())

    def _redraw(self) -> None:
        """Draw at most every DRAWING_PERIOD_S: it takes milliseconds of a processor that the flight needs."""
        if self._live is not None and time.monotonic() >= self._next_drawing:
            self._next_drawing = time.monotonic() + DRAWING_PERIOD_S
            self._live.update(self.status.table(), refresh=True)

    def _print(self, text: str) -> None:
        self._console.print(text, markup=False, highlight=False, soft_wrap=True)


def _number(value: Any, unit: str, digits: int) -> str:
    if not isinstance(value, int | float) or value != value:
        return "-"
    return f"{value:.{digits}f} {unit}".rstrip()


def _mode(onboard: dict[str, Any]) -> str:
    """The flight mode, and what the vehicle waits for before it can be armed."""
    reason = onboard.get("not_ready")
    return f"{onboard.get('mode', '-')}, {reason}" if reason else str(onboard.get("mode", "-"))


def _features(onboard: dict[str, Any]) -> str:
    version = onboard.get("feature_version")
    if version is None:
        return "-"
    age = onboard.get("feature_age_s")
    old = f", {age:.1f} s old" if isinstance(age, int | float) and version else ""
    return f"version {version}{old}"


def _losses(offboard: dict[str, Any]) -> str:
    """Return the mean squared error of the newest training round on validation samples, by channel."""
    if not offboard:
        return "-"
    losses = [_number(offboard.get(f"validation_loss_{channel}"), "", 3) for channel in ("position", "attitude")]
    return f"{losses[0]} (m/s^2)^2, {losses[1]} (rad/s^2)^2, round {offboard.get('rounds', '-')}"


def _loss(sim: dict[str, Any], direction: str) -> str:
    counts = sim.get("link", {}).get(direction, {})
    sent = counts.get("sent", 0)
    return f"{100 * counts['lost'] / sent:.1f} %" if sent else "-"
