"""The integral of a PID controller: limit, anti-windup, hold."""

import dataclasses

import numpy as np
import pytest

from onboard.control.laws.integral import Integral, IntegralConfig
from onboard.control.laws.law import ChannelState
from onboard.control.records import ChannelTelemetry
from tests.onboard.control.fixture import DT, Rig, column, shipped_controller


def integral(seconds: float, error: float, saturated: bool, start: float = 0.0) -> float:
    block = Integral(IntegralConfig(kind="integral", gain=(16.0, 16.0, 30.0), limit=6.0))
    channel = ChannelState(dt=DT, adapt=True)
    block._nu = np.full(3, start)
    for _ in range(round(seconds / DT)):
        channel.tracking_error[:3] = error
        channel.saturated = saturated
        nu = block.step(channel, ChannelTelemetry())
    return float(nu[0])


def test_the_integral_winds_up_only_to_its_limit_and_not_in_saturation() -> None:
    assert integral(1.0, 0.1, False) == pytest.approx(-1.6)
    assert integral(60.0, 0.1, False) == -6.0
    assert integral(60.0, 0.1, True) == 0.0
    assert integral(0.5, 0.1, True, start=-2.0) == -2.0


def test_the_integral_unwinds_in_saturation() -> None:
    assert integral(0.5, -0.1, True, start=-2.0) == pytest.approx(-1.2)


def test_the_integral_holds_while_it_may_not_adapt() -> None:
    block = Integral(IntegralConfig(kind="integral", gain=(16.0,) * 3, limit=6.0))
    channel = ChannelState(dt=DT, adapt=False)
    channel.tracking_error[:] = 1.0
    assert block.step(channel, ChannelTelemetry()).tolist() == [0.0, 0.0, 0.0]


def test_what_nu_ad_makes_up_for_comes_on_top_of_the_climb_limit() -> None:
    """Motors that give a third less than the nominal thrust: the climb limit alone would not lift the vehicle."""
    rig = Rig(shipped_controller("bias", {"limits": {"climb_acceleration_max_m_s2": 3.0}}), force=(0.0, 0.0, 5.0))
    down = column(rig.fly(6.0), "position")[:, 2]
    assert abs(float(down[-1]) + 1.0) < 0.05


def test_anti_windup_shortens_the_overshoot() -> None:
    """A load the motors cannot hold, let go; with the flag withheld the integral winds up and the vehicle shoots up."""
    wide = {"position": {"augmentation": {"limit": 30.0}}}

    def overshoot(tell: bool) -> float:
        rig = Rig(shipped_controller("pid", wide), force=(0.0, 0.0, 11.0))
        rig.target = np.array([0.0, 0.0, -1.0])
        if not tell:
            step = rig.controller.step
            rig.controller.step = lambda inputs: step(dataclasses.replace(inputs, saturated=False))
        rig.fly(1.0)
        rig.force[:] = 0.0
        return float(-1.0 - column(rig.fly(3.0), "position")[:, 2].min())

    assert overshoot(True) < 0.7 * overshoot(False)
