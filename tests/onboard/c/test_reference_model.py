"""The hedged reference models: the C core against numpy's."""

import numpy as np
from hypothesis import given

from onboard.c.library import Core
from onboard.control.reference_model import AttitudeReferenceModel, ChannelGains, PositionReferenceModel
from tests.onboard.c.parity import SETTINGS, array, call, configured, quaternions, same, vectors
from tests.onboard.control.fixture import DT

GAINS = ChannelGains(natural_frequency_rad_s=(4.0, 5.0, 17.0), damping=0.8)


def test_gains(core: Core) -> None:
    gains = configured(core, GAINS)
    same(call(core, "gains_stiffness", gains, out=3), GAINS.stiffness())
    same(call(core, "gains_rate_gain", gains, out=3), GAINS.rate_gain())


@SETTINGS
@given(start=vectors(6, 5.0), command=vectors(3, 20.0), hedge=vectors(3, 5.0), jump=vectors(3, 1.0), x=vectors(6, 5.0))
def test_position_model(
    core: Core, start: list[float], command: list[float], hedge: list[float], jump: list[float], x: list[float]
) -> None:
    ours, theirs = core.PositionReferenceModel(), PositionReferenceModel(GAINS)
    core.position_model_init(ours, configured(core, GAINS))
    theirs.reset(np.array(start[:3]), np.array(start[3:]))
    core.position_model_reset(ours, array(core, start[:3]), array(core, start[3:]))
    for _ in range(3):
        theirs.step((*command,), (*hedge,), DT)
        core.position_model_step(ours, array(core, command), array(core, hedge), DT)
    theirs.shift(np.array(jump))
    core.position_model_shift(ours, array(core, jump))
    e = np.empty(6)
    theirs.error(np.array(x[:3]), np.array(x[3:]), e)
    same(call(core, "position_model_error", ours, x[:3], x[3:], out=6), e, scale=1.0)


@SETTINGS
@given(
    start=quaternions(), vehicle=quaternions(), rates=vectors(6, 5.0), command=vectors(3, 100.0), hedge=vectors(3, 20.0)
)
def test_attitude_model(
    core: Core,
    start: list[float],
    vehicle: list[float],
    rates: list[float],
    command: list[float],
    hedge: list[float],
) -> None:
    ours, theirs = core.AttitudeReferenceModel(), AttitudeReferenceModel(GAINS)
    core.attitude_model_init(ours, configured(core, GAINS))
    theirs.reset(np.array(start), np.array(rates[:3]))
    core.attitude_model_reset(ours, array(core, start), array(core, rates[:3]))
    for attitude in (start, vehicle):
        theirs.step((*command,), (*hedge,), DT)
        core.attitude_model_step(ours, array(core, command), array(core, hedge), DT)
        e = np.empty(6)
        theirs.error(np.array(attitude), np.array(rates[3:]), e)
        same(call(core, "attitude_model_error", ours, attitude, rates[3:], out=6), e, scale=10.0)
    same(ours.quaternion, theirs.quaternion)
    same(ours.rates, theirs.rates, scale=10.0)
