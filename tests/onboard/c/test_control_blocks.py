"""Mixer, actuator model, thrust scale, demand limits, uncertainty measurement: the C core against numpy's."""

from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from onboard.c.library import Core
from onboard.control.actuators import CATCH_UP_MAX, ActuatorModel, Delivered
from onboard.control.demand_limits import DemandLimits, DemandLimitsConfig, thrust_along
from onboard.control.mixer import Mixer, wrench
from onboard.control.thrust_scale import ThrustScale, ThrustScaleConfig
from onboard.control.uncertainty import UncertaintyMeasurement
from onboard.estimation.state import VehicleState
from protocol.geometry import rotation_of
from tests.onboard.c.parity import SETTINGS, array, call, configured, filled, numbers, quaternions, same, vectors
from tests.onboard.control.fixture import AIRFRAME, DT

THRUSTS = vectors(4, 0.4)
SHARES = st.lists(numbers(1.0, 0.0), min_size=4, max_size=4)
SCALES = st.one_of(st.just(1.0), st.floats(0.5, 1.3))


def airframe(core: Core) -> Any:
    return filled(core.AirframeConfig, AIRFRAME)


@SETTINGS
@given(thrust=numbers(2.0, -0.5), torque=vectors(3, 0.02), scale=SCALES)
def test_mixer(core: Core, thrust: float, torque: list[float], scale: float) -> None:
    ours, theirs = core.Mixer(), Mixer(AIRFRAME)
    core.mixer_init(ours, airframe(core))
    ours.scale = theirs.scale = scale
    roll, pitch, yaw = torque
    expected = theirs.thrusts(thrust, (roll, pitch, yaw))
    thrusts = call(core, "mixer_thrusts", ours, thrust, torque, out=4)
    same(thrusts, expected)
    same(call(core, "wrench", airframe(core), expected, out=4), wrench(AIRFRAME, expected))
    short = core.mixer_falls_short(ours, thrusts, thrust, array(core, torque))
    assert short == theirs.falls_short(expected, thrust, (roll, pitch, yaw))


@SETTINGS
@given(
    commands=st.lists(st.tuples(SHARES, st.integers(0, 3), SCALES), min_size=1, max_size=4),
    ahead=SHARES,
    wanted=THRUSTS,
)
def test_actuator_model(core: Core, commands: list[Any], ahead: list[float], wanted: list[float]) -> None:
    ours, theirs = core.ActuatorModel(), ActuatorModel(AIRFRAME, DT)
    core.actuators_init(ours, airframe(core), DT)
    passed = (core.Delivered * (1 + CATCH_UP_MAX))()
    for command, missed, scale in commands:
        theirs.scale = scale
        core.actuators_set_scale(ours, scale)
        same_delivered(ours.delivered, theirs.delivered)
        expected = theirs.catch_up((*command,), missed)
        assert core.actuators_catch_up(ours, array(core, command), missed, passed) == len(expected)
        for one, other in zip(passed, expected, strict=False):
            same_delivered(one, other)
    coming = core.Delivered()
    core.actuators_ahead(ours, array(core, ahead), coming)
    same_delivered(coming, theirs.ahead((*ahead,)))
    same_delivered(ours.delivered, theirs.delivered)
    same(call(core, "actuators_overdriven", ours, wanted, out=4), theirs.overdriven((*wanted,)))


def test_no_more_ticks_are_caught_up_than_there_is_room_for(core: Core) -> None:
    ours = core.ActuatorModel()
    core.actuators_init(ours, airframe(core), DT)
    passed, command = (core.Delivered * (1 + CATCH_UP_MAX))(), array(core, [0.5] * 4)
    assert core.actuators_catch_up(ours, command, CATCH_UP_MAX + 9, passed) == 1 + CATCH_UP_MAX
    assert core.actuators_catch_up(ours, command, -1, passed) == 1


@SETTINGS
@given(
    ticks=st.lists(
        st.tuples(
            st.one_of(numbers(30.0), st.sampled_from([float("nan"), float("inf")])),
            numbers(3.0, 0.0),
            st.sampled_from([True, True, False]),
        ),
        min_size=1,
        max_size=12,
    ),
    enabled=st.booleans(),
    tau=st.floats(0.3, 9.0),
    reset_at=st.integers(0, 12),
)
def test_thrust_scale(core: Core, ticks: list[Any], enabled: bool, tau: float, reset_at: int) -> None:
    config = ThrustScaleConfig(enabled=enabled, time_constant_s=tau, start_time_constant_s=0.2)
    ours, theirs = core.ThrustScale(), ThrustScale(config, AIRFRAME, DT)
    core.thrust_scale_init(ours, configured(core, config), airframe(core), DT)
    for index, (force, weights, adapt) in enumerate(ticks):
        delivered_n = weights * AIRFRAME.mass_kg * 9.8
        theirs.step(force, delivered_n, adapt)
        core.thrust_scale_step(ours, force, delivered_n, adapt)
        same(ours.value, theirs.value)
        if index == reset_at:
            theirs.reset()
            core.thrust_scale_reset(ours)


def test_the_thrust_scale_finds_weak_motors(core: Core) -> None:
    """Both cores through the fast beginning into the slow end, with motors of 70 %."""
    ours, theirs = core.ThrustScale(), ThrustScale(ThrustScaleConfig(), AIRFRAME, DT)
    core.thrust_scale_init(ours, configured(core, ThrustScaleConfig()), airframe(core), DT)
    nominal_n, rng = AIRFRAME.mass_kg * 9.8, np.random.default_rng(1)
    for _ in range(800):
        force = -0.7 * 9.8 + float(rng.normal(scale=0.5))
        theirs.step(force, theirs.value * nominal_n, True)
        core.thrust_scale_step(ours, force, ours.value * nominal_n, True)
    same(ours.value, theirs.value)
    assert abs(ours.value - 0.7) < 0.03


@SETTINGS
@given(
    ticks=st.lists(st.tuples(vectors(3, 15.0), numbers(6.0), numbers(6.0), st.booleans()), min_size=1, max_size=8),
    dt=st.sampled_from([DT, 4.0 * DT, 0.5]),
    reset_at=st.integers(0, 8),
)
def test_demand_limits(core: Core, ticks: list[Any], dt: float, reset_at: int) -> None:
    config = DemandLimitsConfig()
    ours, theirs = core.DemandLimits(), DemandLimits(config)
    core.demand_limits_init(ours, configured(core, config))
    for index, (u, nu_z, residual_z, adapting) in enumerate(ticks):
        theirs.step(adapting, residual_z, dt)
        core.demand_limits_step(ours, adapting, residual_z, dt)
        same(ours.lack, theirs.lack, scale=1.0)
        f = call(core, "demand_limits_specific_thrust", ours, u, nu_z, out=3)
        same(f, theirs.specific_thrust((*u,), nu_z), scale=1.0)
        if index == reset_at:
            theirs.reset()
            core.demand_limits_reset(ours)


@SETTINGS
@given(horizontal=vectors(2, 15.0), fz=st.floats(2.0, 20.0), q=quaternions(), near=st.booleans())
def test_thrust_along(core: Core, horizontal: list[float], fz: float, q: list[float], near: bool) -> None:
    """Any attitude, and one near the wanted one, where projection and height are mixed."""
    f = np.array([*horizontal, fz])
    axis = np.reshape(rotation_of((*q,)), (3, 3))[:, 2]
    if near:
        axis = f / np.linalg.norm(f) + 0.4 * axis
        axis /= np.linalg.norm(axis)
    expected = thrust_along(tuple(f.tolist()), tuple(axis.tolist()))
    same(core.thrust_along(f, array(core, axis)), expected, rtol=1e-11, scale=10.0)


def same_delivered(ours: Any, theirs: Delivered) -> None:
    same(ours.thrusts_n, theirs.thrusts_n)
    same(ours.thrust_n, theirs.thrust_n, scale=1.0)
    same(ours.torque_nm, theirs.torque_nm, scale=0.01)


@SETTINGS
@given(q=quaternions(), rates=vectors(6, 5.0), force=vectors(3, 20.0), first=vectors(4, 1.0), later=vectors(12, 1.0))
def test_uncertainty(
    core: Core, q: list[float], rates: list[float], force: list[float], first: list[float], later: list[float]
) -> None:
    """One period, then one tick after two missed ones."""
    ours, theirs, state = core.UncertaintyMeasurement(), UncertaintyMeasurement(AIRFRAME, DT), VehicleState()
    core.uncertainty_init(ours, airframe(core), DT)
    state.rotation[:] = np.reshape(rotation_of((*q,)), (3, 3))
    for turning, values in ((rates[:3], first), (rates[3:], later)):
        state.rates[:], state.specific_force[:] = turning, force
        passed = [delivered_of(values[i : i + 4]) for i in range(0, len(values), 4)]
        c_passed = (core.Delivered * len(passed))(*(filled(core.Delivered, one) for one in passed))
        position, attitude = theirs.step(state, passed)
        core.uncertainty_step(ours, filled(core.VehicleState, state), c_passed, len(passed))
        for one, other in ((ours.position, position), (ours.attitude, attitude)):
            same(one.u_hat, other.u_hat, scale=1.0)
            same(one.residual, other.residual, scale=20.0)
    ahead, at_once, in_a_tick = delivered_of(first), np.empty(3), np.empty(3)
    c_state, c_ahead = filled(core.VehicleState, state), filled(core.Delivered, ahead)
    core.uncertainty_coming(ours, c_state, c_passed[len(passed) - 1], c_ahead, at_once, in_a_tick)
    for one, other in zip((at_once, in_a_tick), theirs.coming(state, passed[-1], ahead), strict=True):
        same(one, other, scale=1.0)


def delivered_of(values: list[float]) -> Delivered:
    """Thrust, and torque in units of 0.01 N m."""
    thrust, x, y, z = values
    return Delivered(np.zeros(4), thrust, (0.01 * x, 0.01 * y, 0.01 * z))
