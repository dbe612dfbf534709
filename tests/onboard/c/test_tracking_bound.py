"""The live bound on the tracking error: the C core against numpy's."""

import ctypes
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.c.library import Core
from onboard.control.command_motion import CommandMotion
from onboard.control.records import ChannelMeasurement, ControlInputs, ControlOutput, Target
from onboard.control.reference_model import ChannelGains
from onboard.control.tracking_bound import TrackingBounds, majorant
from onboard.estimation.state import VehicleState
from onboard.flight.trajectory import PathPoint
from protocol.geometry import vector
from protocol.signals import SIGNAL_COUNT
from tests.onboard.c.parity import SETTINGS, call, configured, filled, quaternions, same, vectors, view
from tests.onboard.control.fixture import DT

POSITION = ChannelGains(natural_frequency_rad_s=(5.6, 5.6, 5.0), damping=0.68)
ATTITUDES = [
    ChannelGains(natural_frequency_rad_s=(17.3, 17.3, 5.0), damping=damping) for damping in (0.35, 0.8, 1.0, 1.56)
]
MEMBERS = ("state", "target", "position", "attitude")
"""Of ControlInputs, what the bounds read."""


@SETTINGS
@given(omega=st.floats(0.5, 60.0), zeta=st.one_of(st.floats(0.3, 3.0), st.just(1.0)))
def test_majorant(core: Core, omega: float, zeta: float) -> None:
    ours = core.Majorant()
    core.majorant(omega, zeta, ours)
    same([ours.fast, ours.slow, ours.gain], majorant(omega, zeta))


TICK = st.tuples(
    vectors(18, 2.0), vectors(12, 5.0), quaternions(), quaternions(), st.sampled_from([True, True, True, False])
)


@SETTINGS
@given(
    ticks=st.lists(TICK, min_size=1, max_size=6),
    attitude=st.sampled_from(ATTITUDES),
    jump_at=st.integers(0, 6),
    missed_at=st.integers(0, 6),
    other_period_at=st.integers(0, 6),
    reset_at=st.integers(0, 6),
)
def test_bounds(
    core: Core,
    ticks: list[Any],
    attitude: ChannelGains,
    jump_at: int,
    missed_at: int,
    other_period_at: int,
    reset_at: int,
) -> None:
    ours, theirs = core.TrackingBounds(), TrackingBounds(POSITION, attitude)
    core.tracking_bounds_init(ours, configured(core, POSITION), configured(core, attitude))
    state, output = VehicleState(position_sigma_m=0.01), ControlOutput()
    position, measured = ChannelMeasurement(), ChannelMeasurement()
    for index, (moves, turns, q, commanded, adapt) in enumerate(ticks):
        point = PathPoint(*(tuple(moves[i : i + 3]) for i in (0, 3, 6)))
        state.position[:], state.velocity[:], position.u_hat[:] = moves[9:12], moves[12:15], moves[15:18]
        state.rates[:], measured.u_hat[:], measured.residual[:] = turns[:3], turns[3:6], turns[6:9]
        state.quaternion[:], output.commanded_quaternion = q, tuple(commanded)
        state.position_reset_count += index == jump_at
        missed = 2 if index == missed_at else 0
        dt = (1 + missed) * (2.0 * DT if index == other_period_at else DT)
        motion = CommandMotion(0.03, 1.0)
        motion.turn, motion.omega_d, motion.alpha_d = (
            vector(share * x for x in turns[9:12]) for share in (0.02, 1.0, 10.0)
        )
        target = Target(point, (0.0,) * 3, point, point, 0.0, point)
        signals, coming = np.zeros((SIGNAL_COUNT, 2)), ((0.0,) * 3, (0.0,) * 3)
        inputs = ControlInputs(dt, state, target, signals, position, measured, False, adapt, coming, missed=missed)
        theirs.step(inputs, output, motion)
        kept = [
            filled(core.VehicleState, state),
            filled(core.Target, target),
            filled(core.ChannelMeasurement, position),
            filled(core.ChannelMeasurement, measured),
        ]
        members = dict(zip(MEMBERS, map(ctypes.pointer, kept), strict=True))
        c_inputs = core.ControlInputs(dt=dt, adapt=adapt, missed=missed, **members)
        bounds = call(core, "tracking_bounds_step", ours, c_inputs, commanded, fed_forward(core, motion), out=2)
        same(bounds, [output.position.tracking_bound, output.attitude.tracking_bound])
        if index == reset_at:
            theirs.reset()
            core.tracking_bounds_reset(ours)


def fed_forward(core: Core, motion: CommandMotion) -> Any:
    ours = core.CommandMotion()
    for name in ("turn", "omega_d", "alpha_d"):
        view(getattr(ours, name))[...] = getattr(motion, name)
    return ours


def test_nothing_is_bounded_while_nothing_adapts(core: Core) -> None:
    ours = core.TrackingBounds()
    core.tracking_bounds_init(ours, configured(core, POSITION), configured(core, POSITION))
    inputs = core.ControlInputs(dt=DT)  # nothing else is read
    assert list(call(core, "tracking_bounds_step", ours, inputs, np.zeros(4), core.CommandMotion(), out=2)) == [
        0.0,
        0.0,
    ]


def test_the_bound_of_a_known_error_is_that_error(core: Core) -> None:
    ours, target = core.TrackingBounds(), core.Target()
    core.tracking_bounds_init(ours, configured(core, POSITION), configured(core, POSITION))
    target.path.position[0] = 0.3
    state = filled(core.VehicleState, VehicleState())
    nothing = core.ChannelMeasurement()
    members = dict(zip(MEMBERS, map(ctypes.pointer, (state, target, nothing, nothing)), strict=True))
    inputs = core.ControlInputs(dt=DT, adapt=True, **members)
    bounds = call(core, "tracking_bounds_step", ours, inputs, [1.0, 0.0, 0.0, 0.0], core.CommandMotion(), out=2)
    assert bounds[0] == pytest.approx(0.3)
    assert bounds[1] == 0.0
