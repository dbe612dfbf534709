"""The motion of the commanded attitude that is fed forward: the C core against numpy's."""

import ctypes
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.c.library import Core
from onboard.control.command_motion import COMMAND_JUMP_RAD, CommandMotion
from onboard.control.records import ChannelMeasurement, ControlInputs, Target
from onboard.estimation.state import VehicleState
from onboard.flight.path_turn import PathTurn
from onboard.flight.trajectory import PathPoint
from protocol.geometry import ZERO, quaternion_multiply, vector
from protocol.signals import SIGNAL_COUNT
from tests.onboard.c.parity import SETTINGS, array, filled, quaternions, same, vectors
from tests.onboard.control.fixture import DT

TICKS = st.lists(
    st.tuples(vectors(3, 0.6), vectors(3, 5.0), vectors(3, 50.0), quaternions(), st.booleans(), st.booleans()),
    min_size=1,
    max_size=12,
)


def inputs_with(state: VehicleState, turn: PathTurn, adapt: bool, level_only: bool) -> ControlInputs:
    rest = PathPoint(ZERO, ZERO, ZERO)
    target, measured = Target(rest, ZERO, rest, rest, 0.0, rest, turn), ChannelMeasurement()
    signals = np.zeros((SIGNAL_COUNT, 2))
    return ControlInputs(DT, state, target, signals, measured, measured, False, adapt, level_only=level_only)


@pytest.mark.parametrize(("filter_s", "share"), [(0.03, 1.0), (0.03, 0.4), (0.0, 1.0), (0.03, 0.0)])
@SETTINGS
@given(ticks=TICKS)
def test_command_motion(core: Core, filter_s: float, share: float, ticks: list[Any]) -> None:
    ours, theirs, state = core.CommandMotion(), CommandMotion(filter_s, share), VehicleState()
    core.command_motion_init(ours, filter_s, share)
    commanded = (1.0, 0.0, 0.0, 0.0)
    for step, rate, acceleration, q, adapt, level_only in ticks:
        commanded = quaternion_multiply(commanded, (1.0, *step))
        norm = sum(x * x for x in commanded) ** 0.5
        commanded = tuple(x / norm for x in commanded)
        w, x, y, z = q
        state.rotation[:] = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
        inputs = inputs_with(state, PathTurn(vector(rate), vector(acceleration)), adapt, level_only)
        theirs.step(commanded, inputs)
        kept = filled(core.VehicleState, state), filled(core.Target, inputs.target)
        members = dict(zip(("state", "target"), map(ctypes.pointer, kept), strict=True))
        c_inputs = core.ControlInputs(dt=DT, adapt=adapt, level_only=level_only, **members)
        core.command_motion_step(ours, array(core, commanded), c_inputs)
        for name in ("turn", "omega_d", "alpha_d"):
            same(getattr(ours, name), getattr(theirs, name), scale=1.0 / DT)


def test_a_jump_of_the_command_is_no_rate() -> None:
    motion, state = CommandMotion(0.03, 1.0), VehicleState()
    inputs = inputs_with(state, PathTurn((0.5, 0.0, 0.0), (2.0, 0.0, 0.0)), True, False)
    for angle in (0.0, 1.5 * COMMAND_JUMP_RAD):
        motion.step((np.cos(0.5 * angle), np.sin(0.5 * angle), 0.0, 0.0), inputs)
    assert motion.turn[0] == pytest.approx(1.5 * COMMAND_JUMP_RAD)
    assert abs(motion.omega_d[0]) < 0.5 + 0.2
    assert motion.alpha_d == (2.0, 0.0, 0.0)


def test_what_feedback_adds_passes_the_filter_and_the_path_does_not() -> None:
    """A command that turns at 1 rad/s, of which the path explains 0.6."""
    motion, state = CommandMotion(0.03, 1.0), VehicleState()
    inputs = inputs_with(state, PathTurn((0.6, 0.0, 0.0), ZERO), True, False)
    rates = []
    for tick in range(60):
        half = 0.5 * DT * tick
        motion.step((np.cos(half), np.sin(half), 0.0, 0.0), inputs)
        rates.append(motion.omega_d[0])
    assert rates[1] == pytest.approx(0.6 + 0.4 * (1.0 - np.exp(-DT / 0.03)), abs=0.1)
    assert rates[-1] == pytest.approx(1.0, abs=1e-3)
    assert 0.6 < rates[5] < 0.95
