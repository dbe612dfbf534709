"""A simulated gyroscope with an axis that is stuck."""

import numpy as np
import pytest

from configs.loader import ConfigError
from sim_vehicle.config import load_vehicle

TICK = 5_000_000
HIGH = {"initial": {"position_ned_m": [0.0, 0.0, -4.0]}}


def rates(flying, frames, ticks=60):
    """[ticks, 3] of the IMU's samples."""
    messages = [m for k in range(ticks) for m in frames(flying.step((k + 1) * TICK).to_onboard, "HIL_SENSOR")]
    return np.array([(m.xgyro, m.ygyro, m.zgyro) for m in messages])


def stuck(axis, **settings):
    return {"kind": "gyro_stuck", "axis": axis, "onset_s": 0.1, **settings}


def test_the_axis_keeps_its_last_value_and_the_others_go_on(vehicle, frames):
    good = rates(vehicle(HIGH), frames)
    seen = rates(vehicle(HIGH | {"disturbances": [stuck("y")]}), frames)
    assert (seen[19:, 1] == seen[18, 1]).all()
    np.testing.assert_array_equal(seen[:19], good[:19])
    np.testing.assert_array_equal(seen[:, [0, 2]], good[:, [0, 2]])


def test_it_can_be_stuck_at_a_given_rate_and_recover(vehicle, frames):
    seen = rates(vehicle(HIGH | {"disturbances": [stuck("z", rate_rad_s=0.5, end_s=0.2)]}), frames)
    assert (seen[19:39, 2] == 0.5).all()
    assert np.abs(seen[40:, 2]).max() < 0.4


def test_two_axes_can_be_stuck(vehicle, frames):
    both = [stuck("x", rate_rad_s=0.0), stuck("z", rate_rad_s=0.25)]
    seen = rates(vehicle(HIGH | {"disturbances": both}), frames)
    assert (seen[19:, [0, 2]] == (0.0, 0.25)).all()
    assert len(set(seen[19:, 1])) > 3


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"axis": "w"}, r"axis.*'x', 'y' or 'z'"),
        ({"axis": "x", "rate_rad_s": float("nan")}, "rate_rad_s.*finite"),
        ({"axis": "x", "rate": 0.0}, "unknown key; gyro_stuck allows axis"),
    ],
)
def test_bad_settings_are_named(settings, message):
    with pytest.raises(ConfigError, match=message):
        load_vehicle("mambo", {"disturbances": [{"kind": "gyro_stuck", **settings}]})
