"""Faults of the sensors, the clock and the link of the vehicle."""

from math import isnan

import numpy as np
import pytest

from configs.loader import ConfigError
from sim_vehicle.config import load_vehicle

TICK = 5_000_000
HIGH = {"initial": {"position_ned_m": [0.0, 0.0, -4.0]}, "sensors": {"motion_capture": {"loss_probability": 0.0}}}
KINDS = {
    "imu": "HIL_SENSOR",
    "flow": "HIL_OPTICAL_FLOW",
    "ultrasonic": "DISTANCE_SENSOR",
    "battery": "BATTERY_STATUS",
    "motion_capture": "ODOMETRY",
}


def flown(flying, frames, seconds=0.5, motors=None):
    messages = []
    for k in range(round(seconds * 200)):
        if motors is not None:
            flying.receive(motors([0.47] * 4), k * TICK)
        output = flying.step((k + 1) * TICK)
        messages += frames(output.to_onboard + output.to_motion_capture)
    return messages


@pytest.mark.parametrize("sensor", ["imu", "flow", "ultrasonic", "battery", "motion_capture"])
def test_only_the_silent_sensor_is_missing(vehicle, frames, sensor):
    fault = {"kind": "sensor_fault", "sensor": sensor, "fault": "silent", "onset_s": 0.0}
    seen = {message.get_type() for message in flown(vehicle(HIGH | {"disturbances": [fault]}), frames, 1.01)}
    assert {*KINDS.values(), "HEARTBEAT"} - seen == {KINDS[sensor]}


def test_silence_ends(vehicle, frames):
    fault = {"kind": "sensor_fault", "sensor": "imu", "fault": "silent", "onset_s": 0.1, "end_s": 0.2}
    imu = [m for m in flown(vehicle(HIGH | {"disturbances": [fault]}), frames) if m.get_type() == "HIL_SENSOR"]
    times = np.array([m.time_usec for m in imu])
    assert np.diff(times).max() == 105_000
    assert not ((times >= 100_000) & (times < 200_000)).any()


def test_a_frozen_sensor_repeats_its_sample_with_fresh_times(vehicle, frames):
    fault = {"kind": "sensor_fault", "sensor": "imu", "fault": "frozen", "onset_s": 0.1}
    imu = [m for m in flown(vehicle(HIGH | {"disturbances": [fault]}), frames) if m.get_type() == "HIL_SENSOR"]
    assert [m.time_usec for m in imu] == [5000 * (k + 1) for k in range(100)]
    assert len({m.xacc for m in imu[:19]}) > 10
    assert len({(m.xacc, m.zgyro, m.abs_pressure) for m in imu[18:]}) == 1


@pytest.mark.parametrize(
    ("sensor", "fields"),
    [("imu", ("xacc", "zgyro")), ("flow", ("integrated_x",)), ("motion_capture", ("x", "z"))],
)
def test_a_not_finite_sensor_sends_nan(vehicle, frames, sensor, fields):
    fault = {"kind": "sensor_fault", "sensor": sensor, "fault": "not_finite"}
    messages = flown(vehicle(HIGH | {"disturbances": [fault]}), frames, 0.1)
    bad = [m for m in messages if m.get_type() == KINDS[sensor]]
    assert bad
    assert all(isnan(getattr(m, name)) for m in bad for name in fields)


def test_whole_numbers_cannot_be_nan():
    fault = {"kind": "sensor_fault", "sensor": "battery", "fault": "not_finite"}
    with pytest.raises(ConfigError, match="whole numbers"):
        load_vehicle("mambo", {"disturbances": [fault]})


def test_a_restarted_clock_counts_from_zero(vehicle, frames):
    jump = {"kind": "clock_jump", "jump_s": -0.25, "onset_s": 0.25}
    messages = flown(vehicle(HIGH | {"disturbances": [jump]}), frames)
    imu = [m.time_usec for m in messages if m.get_type() == "HIL_SENSOR"]
    assert imu[:49] == [5000 * (k + 1) for k in range(49)]
    assert imu[49:] == [5000 * k for k in range(51)]
    capture = [m.time_usec for m in messages if m.get_type() == "ODOMETRY"]
    assert capture == [10_000 * (k + 1) for k in range(len(capture))]


def test_an_impaired_vehicle_link_delays_both_directions(vehicle, frames, motors):
    wire = {"up": {"delay_s": 0.0035}, "down": {"delay_s": 0.0065}}
    flying = vehicle(HIGH | {"impairment": wire})
    flying.receive(motors([0.5] * 4), 0)
    thrusts, arrivals = [], []
    for k in range(1, 31):
        output = flying.step(k * 1_000_000)
        thrusts.append(output.truth[19])
        arrivals += [k * 1000 - m.time_usec for m in frames(output.to_onboard, "HIL_SENSOR")]
    assert thrusts[6] == 0.0
    assert thrusts[7] > 0.0
    assert arrivals == [4000] * 5


def test_an_impaired_vehicle_link_loses_and_corrupts(vehicle, motors):
    wire = {"up": {"loss": 0.3}, "down": {"loss": 0.2, "corruption": 0.2}}
    flying = vehicle(HIGH | {"impairment": wire}, seed=4)
    received = 0
    for k in range(200):
        flying.receive(motors([0.47] * 4), k * TICK)
        received += len(flying.step((k + 1) * TICK).to_onboard)
    assert 140 < received < 225  # of 288
    assert 15 < sum(flying.rejected.values()) < 55
    assert flying.crash_reason == ""
