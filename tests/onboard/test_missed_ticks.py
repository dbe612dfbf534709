"""Onboard's process stands still and misses ticks; the next tick catches up with what has passed. In virtual time."""

import numpy as np
import pytest

from onboard.control.actuators import CATCH_UP_MAX, ActuatorModel
from onboard.control.uncertainty import UncertaintyMeasurement
from onboard.core import OnboardCore, OnboardOutput
from onboard.estimation.state import VehicleState
from protocol.arrival import Arrival
from tests.onboard.control.fixture import AIRFRAME
from tests.onboard.loop import Loop, Peer

DT = 0.005
EVERY = 60
"""Ticks from one stall to the next: 0.3 s."""
FIRST = 500
SECONDS = 9.0


class StallingCore:
    """A core that misses `ticks` of every EVERY ticks; its datagrams wait in the socket, its last command acts on."""

    def __init__(self, core: OnboardCore, ticks: int, tells: bool) -> None:
        self._core, self._stall, self._tells = core, ticks, tells
        self._tick = self._missed = 0
        self._waiting = [], []
        self._output = OnboardOutput()

    def __getattr__(self, name: str):
        return getattr(self._core, name)

    def tick(self, now_ns, from_vehicle, from_offboard, from_ground=(), land=False):
        for waiting, came in zip(self._waiting, (from_vehicle, from_offboard), strict=True):
            waiting.extend((datagram, now_ns) for datagram in came)
        self._tick += 1
        if self._tick >= FIRST and (self._tick - FIRST) % EVERY < self._stall:
            self._missed += 1
            return self._output.cleared()
        received = [[Arrival(datagram, now_ns - at_ns) for datagram, at_ns in one] for one in self._waiting]
        self._waiting = [], []
        missed = self._missed if self._tells else 0
        self._output = self._core.tick(now_ns, *received, from_ground, land, missed_ticks=missed)
        return self._output


def flown(ticks: int, tells: bool = True) -> float:
    """RMS distance of a figure-8 from its target, m, with a stall of `ticks` missed ticks every EVERY ticks."""
    loop = Loop("mrac", scenario="figure8_calm", peer=Peer())
    loop.core = StallingCore(loop.core, ticks, tells)
    loop.fly(SECONDS)
    assert not loop.vehicle.crash_reason
    error = np.array(loop.truths)[FIRST:, :3] - loop.vector("target")[FIRST:]
    return float(np.sqrt((error**2).sum(axis=1).mean()))


def test_stalls_of_50_ms_cost_little_and_much_if_onboard_does_not_catch_up():
    """0.0028 m without stalls, 0.0120 with them, 0.034 if the core takes them for ordinary ticks."""
    without, with_stalls, not_told = flown(0), flown(10), flown(10, tells=False)
    assert with_stalls < without + 0.015
    assert not_told > 2.0 * with_stalls


def test_the_actuator_model_applies_each_command_for_as_long_as_it_acted():
    one, other = ActuatorModel(AIRFRAME, DT), ActuatorModel(AIRFRAME, DT)
    first, second, third = (0.1,) * 4, (0.2, 0.1, 0.2, 0.1), (0.05, 0.3, 0.1, 0.15)
    one.catch_up(first, 0)
    one.catch_up(second, 2)
    passed = one.catch_up(third, 3)
    for command in ((0.0,) * 4, first, second, second, second, third, third):
        other.step(command)
    np.testing.assert_array_equal(passed[-2].thrusts_n, other.delivered.thrusts_n)
    other.step(third)
    np.testing.assert_array_equal(passed[-1].thrusts_n, other.delivered.thrusts_n)
    assert one.delivered is passed[-1]
    assert len(passed) == 4


@pytest.mark.parametrize("missed", [0, 1, 9, CATCH_UP_MAX])
def test_the_residual_over_missed_ticks_is_the_mean_disturbance(missed):
    motors, measurement, state = ActuatorModel(AIRFRAME, DT), UncertaintyMeasurement(AIRFRAME, DT), VehicleState()
    measurement.step(state, motors.catch_up((0.15,) * 4, 0))
    disturbance = 2.0
    torque, before = 0.0, motors.delivered.torque_nm[0]
    passed = motors.catch_up((0.14, 0.16, 0.16, 0.14), missed)  # roll alone: nothing turns the axes into each other
    for one in passed:
        torque += 0.5 * (before + one.torque_nm[0]) / len(passed)
        before = one.torque_nm[0]
    state.rates[0] = DT * (1 + missed) * (torque / AIRFRAME.inertia_kg_m2[0] + disturbance)
    _, attitude = measurement.step(state, passed)
    np.testing.assert_allclose(attitude.residual, (disturbance, 0.0, 0.0), atol=1e-9)
    assert abs(torque) > 0.0 or missed == 0
