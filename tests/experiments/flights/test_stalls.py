"""Stalls of processes in real time: the pose keeps its time, and a stall of the simulator is an invalid flight."""

import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from async_dmrac.commands.fly import EXIT_STATUS
from experiments.flights import realtime_flight
from experiments.flights.logged_flight import fly_logged
from experiments.flights.scenario import Choices, resolve
from tests.experiments.processes import on_ports

pytestmark = [pytest.mark.realtime, pytest.mark.full]

STALL_S = 0.03
PERIOD_S = 0.3
RATIO_MAX = 1.2
ABSOLUTE_M = 0.001
"""Two flights without stalls differ by as much."""


class Stalls(threading.Thread):
    """Stops one process of the flight for `stall_s` every `period_s`, from `first_s` after its start on."""

    def __init__(self, name: str, stall_s: float, period_s: float, first_s: float) -> None:
        super().__init__(daemon=True)
        self.child, self.stall_s, self.period_s, self.first_s = name, stall_s, period_s, first_s
        self.over = threading.Event()
        self.count = 0

    def run(self) -> None:
        while not (sim := FLYING.get("onboard")) or not sim.running:
            if self.over.wait(0.05):
                return
        self.over.wait(self.first_s)
        while not self.over.wait(self.period_s - self.stall_s):
            child = FLYING[self.child]
            child.ask(signal.SIGSTOP)
            time.sleep(self.stall_s)
            child.ask(signal.SIGCONT)
            self.count += 1


FLYING: dict[str, realtime_flight.Child] = {}


@pytest.fixture
def fly(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., dict[str, Any]]:
    """Flies with stalls of one process, or without; returns summary.json."""
    make = realtime_flight.Child

    def child(name: str, *rest: Any) -> realtime_flight.Child:
        FLYING[name] = made = make(name, *rest)
        return made

    monkeypatch.setattr(realtime_flight, "Child", child)

    def flown(stalls: Stalls | None, seconds: float) -> dict[str, Any]:
        FLYING.clear()
        folder = tmp_path / ("calm" if stalls is None else stalls.child)
        folder.mkdir()
        if stalls is not None:
            stalls.start()
        config = on_ports(resolve("figure8_calm", Choices("pid", duration_s=seconds)), 16560)
        summary = fly_logged(config, folder, lockstep=False)
        if stalls is not None:
            stalls.over.set()
            stalls.join()
        return summary

    return flown


def test_stalls_of_offboard_do_not_disturb_the_flight(fly: Callable[..., dict[str, Any]]) -> None:
    without = fly(None, 20.0)
    stalls = Stalls("offboard", STALL_S, PERIOD_S, first_s=1.0)
    with_stalls = fly(stalls, 20.0)
    assert stalls.count > 40
    assert without["survived"], without["crash_reason"]
    assert with_stalls["survived"], with_stalls["crash_reason"]
    assert with_stalls["position_rmse_m"] <= RATIO_MAX * without["position_rmse_m"] + ABSOLUTE_M


@pytest.mark.parametrize(
    ("name", "stall_s"),
    [
        *(("onboard", stall_s) for stall_s in (0.005, 0.02, 0.05)),
        *(("offboard", stall_s) for stall_s in (0.005, 0.02, 0.05)),
        *(("sim", stall_s) for stall_s in (0.005, 0.02)),  # after 50 ms without IMU onboard stops the motors
    ],
)
def test_a_flight_survives_stalls_of_each_process(
    fly: Callable[..., dict[str, Any]], name: str, stall_s: float
) -> None:
    """Measured: 9 to 10 mm."""
    summary = fly(Stalls(name, stall_s, PERIOD_S, first_s=1.0), 14.0)
    assert summary["outcome"] == "alive", summary["crash_reason"] or summary["invalid_reason"]
    assert summary["position_rmse_m"] < 0.02


@pytest.mark.parametrize(
    ("stall_s", "first_s", "reason"),
    [
        (0.06, 1.0, "the simulator stood still for"),  # before it is armed, or just after
        (0.06, 5.0, "the motors were stopped when the simulator stood still for"),
        (0.4, 4.0, "the simulator stood still for"),
    ],
)
def test_a_long_stall_of_the_simulator_is_an_invalid_flight(
    fly: Callable[..., dict[str, Any]], stall_s: float, first_s: float, reason: str
) -> None:
    summary = fly(Stalls("sim", stall_s, 2.0 if stall_s > 0.1 else PERIOD_S, first_s), 10.0)
    assert summary["outcome"] == "invalid"
    assert reason in summary["invalid_reason"]
    assert EXIT_STATUS[summary["outcome"]] == 3
