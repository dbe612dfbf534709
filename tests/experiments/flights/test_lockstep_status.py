"""The live status of a lockstep flight."""

import io

import pytest
from rich.console import Console

from experiments.flights import live_status, lockstep_status
from experiments.flights.lockstep_flight import build, fly_lockstep
from experiments.flights.lockstep_status import LockstepStatus
from experiments.flights.scenario import Choices, FlightConfig, resolve

TICKS = 400
START_S = 100.0


class Clock:
    """A clock that advances by 0.1 s each time it is read."""

    def __init__(self) -> None:
        self.now_s = START_S

    def monotonic(self) -> float:
        self.now_s += 0.1
        return self.now_s


def hover() -> FlightConfig:
    return resolve("hover", Choices("pid", duration_s=8.0))


def fly_shown(console: Console, monkeypatch: pytest.MonkeyPatch) -> float:
    """Show some ticks of a flight; returns the time, s, that passed on the clock."""
    clock = Clock()
    monkeypatch.setattr(live_status, "time", clock)
    monkeypatch.setattr(lockstep_status, "time", clock)
    lockstep, *_ = build(hover())
    with LockstepStatus(console, 8.0) as status:
        for _ in range(TICKS):
            status(lockstep.step())
    return clock.now_s - START_S


def test_other_outputs_get_a_line_every_two_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    out = io.StringIO()
    passed_s = fly_shown(Console(file=out), monkeypatch)
    lines = [line for line in out.getvalue().splitlines() if not line.startswith("starting")]
    assert 0.4 < len(lines) * live_status.PLAIN_PERIOD_S / passed_s <= 1.1
    assert lines[0].startswith("time 0.0 of 8.0 s, ")
    assert all(" times real time  mode " in line and "tracking error" in line for line in lines)
    assert "missed ticks" not in out.getvalue()


def test_a_terminal_gets_a_table_with_events(monkeypatch: pytest.MonkeyPatch) -> None:
    out = io.StringIO()
    fly_shown(Console(file=out, force_terminal=True, width=120), monkeypatch)
    assert "of 8.0 s" in out.getvalue()
    assert "onboard: " in out.getvalue()


def test_it_does_not_change_the_flight() -> None:
    config = resolve("hover", Choices("pid", duration_s=5.0))
    with LockstepStatus(Console(file=io.StringIO()), 5.0) as status:
        shown = fly_lockstep(config, (status,))
    assert shown.trace_sha256 == fly_lockstep(config).trace_sha256
