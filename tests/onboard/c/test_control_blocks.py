"""Mixer, actuator model and uncertainty measurement: the C core against numpy's."""

from typing import Any

import numpy as np
from hypothesis import given

from onboard.c.library import Core
from onboard.control.actuators import ActuatorModel, Delivered
from onboard.control.mixer import Mixer, wrench
from onboard.control.uncertainty import UncertaintyMeasurement
from onboard.estimation.state import VehicleState
from protocol.geometry import rotation_of
from tests.onboard.c.parity import SETTINGS, array, call, filled, numbers, quaternions, same, vectors
from tests.onboard.control.fixture import AIRFRAME, DT

THRUSTS = vectors(4, 0.4)


def airframe(core: Core) -> Any:
    return filled(core.AirframeConfig, AIRFRAME)


@SETTINGS
@given(thrust=numbers(2.0, -0.5), torque=vectors(3, 0.02))
def test_mixer(core: Core, thrust: float, torque: list[float]) -> None:
    ours, theirs = core.Mixer(), Mixer(AIRFRAME)
    core.mixer_init(ours, airframe(core))
    roll, pitch, yaw = torque
    expected = theirs.thrusts(thrust, (roll, pitch, yaw))
    thrusts = call(core, "mixer_thrusts", ours, thrust, torque, out=4)
    same(thrusts, expected)
    same(call(core, "wrench", airframe(core), expected, out=4), wrench(AIRFRAME, expected))
    short = core.mixer_falls_short(ours, thrusts, thrust, array(core, torque))
    assert short == theirs.falls_short(expected, thrust, (roll, pitch, yaw))


@SETTINGS
@given(first=THRUSTS, second=THRUSTS, third=THRUSTS)
def test_actuator_model(core: Core, first: list[float], second: list[float], third: list[float]) -> None:
    ours, theirs = core.ActuatorModel(), ActuatorModel(AIRFRAME, DT)
    core.actuators_init(ours, airframe(core), DT)
    for command in (first, second):
        core.actuators_step(ours, array(core, command))
        same_delivered(ours.delivered, theirs.step((*command,)))
    ahead = core.Delivered()
    core.actuators_ahead(ours, array(core, third), ahead)
    same_delivered(ahead, theirs.ahead((*third,)))
    same_delivered(ours.delivered, theirs.delivered)
    same(call(core, "actuators_overdriven", ours, third, out=4), theirs.overdriven((*third,)))


def same_delivered(ours: Any, theirs: Delivered) -> None:
    same(ours.thrusts_n, theirs.thrusts_n)
    same(ours.thrust_n, theirs.thrust_n, scale=1.0)
    same(ours.torque_nm, theirs.torque_nm, scale=0.01)


@SETTINGS
@given(q=quaternions(), rates=vectors(6, 5.0), force=vectors(3, 20.0), now=vectors(4, 1.0), later=vectors(4, 1.0))
def test_uncertainty(
    core: Core, q: list[float], rates: list[float], force: list[float], now: list[float], later: list[float]
) -> None:
    ours, theirs, state = core.UncertaintyMeasurement(), UncertaintyMeasurement(AIRFRAME, DT), VehicleState()
    core.uncertainty_init(ours, airframe(core), DT)
    state.rotation[:] = np.reshape(rotation_of((*q,)), (3, 3))
    for turning, thrust in ((rates[:3], now), (rates[3:], later)):
        state.rates[:], state.specific_force[:] = turning, force
        delivered = Delivered(np.zeros(4), thrust[0], tuple(0.01 * x for x in thrust[1:]))
        position, attitude = theirs.step(state, delivered)
        core.uncertainty_step(ours, filled(core.VehicleState, state), filled(core.Delivered, delivered))
        for one, other in ((ours.position, position), (ours.attitude, attitude)):
            same(one.u_hat, other.u_hat, scale=1.0)
            same(one.residual, other.residual, scale=20.0)
    ahead = Delivered(np.zeros(4), now[0], tuple(0.01 * x for x in now[1:]))
    at_once, in_a_tick = np.empty(3), np.empty(3)
    core.uncertainty_coming(
        ours,
        filled(core.VehicleState, state),
        filled(core.Delivered, delivered),
        filled(core.Delivered, ahead),
        at_once,
        in_a_tick,
    )
    for one, other in zip((at_once, in_a_tick), theirs.coming(state, delivered, ahead), strict=True):
        same(one, other, scale=1.0)
