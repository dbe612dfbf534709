"""Round-trip laws: what one side encodes, the other side decodes to the same values, within the wire's resolution."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from protocol.geometry import rotation_of
from protocol.mavlink.frames import FrameReader, FrameWriter, Message
from protocol.mavlink.motion_capture import DECODERS, encode_odometry, odometry_covariances
from protocol.mavlink.motors import decode_motors, encode_motors
from protocol.mavlink.sensors import decode_flow, decode_imu, decode_range, encode_flow, encode_imu, encode_range
from protocol.mavlink.status import decode_battery, decode_system_status, encode_battery, encode_system_status

LAW = settings(max_examples=60, deadline=None, derandomize=True)
number = st.floats(-1e4, 1e4, width=32)
vector = st.tuples(number, number, number)
quaternion = st.tuples(number, number, number, number)
fraction = st.floats(0.0, 1.0, width=32)
time_us = st.integers(0, 2**40)


def sent(message):
    """The fields after a frame, its checksum and its parsing."""
    (frame,) = FrameReader([message.kind.id]).read(FrameWriter(1, 1).write(message, 0), 0)
    return frame.fields


@LAW
@given(time_us, vector, vector, st.floats(3e4, 1.2e5))
def test_imu(time_us, accelerometer, gyroscope, pressure_pa):
    reading = decode_imu(sent(encode_imu(time_us, accelerometer, gyroscope, pressure_pa)))
    assert reading[:3] == (time_us * 1000, accelerometer, gyroscope)
    assert reading.pressure_pa == pytest.approx(pressure_pa, rel=1e-7)


@LAW
@given(time_us, st.integers(1000, 500_000), st.tuples(number, number), vector, st.integers(0, 255))
def test_flow(time_us, duration_us, flow, rotation, quality):
    reading = decode_flow(sent(encode_flow(time_us, duration_us * 1e-6, flow, rotation, quality)))
    assert reading == (time_us * 1000, duration_us * 1e-6, *flow, *rotation[:2], quality)


@LAW
@given(st.integers(0, 2**31), st.floats(0.0, 600.0))
def test_range(time_ms, distance_m):
    reading = decode_range(sent(encode_range(time_ms * 1000, distance_m, (0.44, 4.0), 0.02)))
    assert (reading.time_ns, reading.least_m) == (time_ms * 1_000_000, 0.44)
    assert reading.distance_m == pytest.approx(distance_m, abs=0.00501)


@LAW
@given(st.floats(0.001, 60.0), fraction)
def test_battery(voltage_v, remaining):
    for message, decode in (
        (encode_battery(voltage_v, 3.0, 100.0, remaining), decode_battery),
        (encode_system_status(1, 1, voltage_v, remaining), decode_system_status),
    ):
        reading = decode(sent(message), 7)
        assert reading.time_ns == 7
        assert reading.voltage_v == pytest.approx(voltage_v, abs=0.000501)
        assert reading.remaining == pytest.approx(remaining, abs=0.00501)


def test_an_unknown_battery_stays_unknown():
    assert decode_battery(sent(encode_battery(0.0, 0.0, 0.0, -1.0)), 0) == (0, 0.0, -1.0)
    assert decode_system_status(sent(encode_system_status(1, 1, 0.0, -1.0)), 0) == (0, 0.0, -1.0)


@LAW
@given(time_us, st.tuples(fraction, fraction, fraction, fraction), st.booleans())
def test_motors(time_us, fractions, armed):
    assert decode_motors(sent(encode_motors(time_us, fractions, armed))) == (fractions, armed)


@LAW
@given(time_us, vector, quaternion, vector)
def test_odometry(time_us, position, attitude, velocity):
    message = encode_odometry(time_us, position, attitude, velocity, odometry_covariances(1.0, 2.0, 3.0))
    pose = DECODERS[message.kind.id](sent(message))
    assert pose == (time_us * 1000, position, attitude)


@pytest.mark.parametrize("angles", [(0.3, -0.4, 1.1), (math.nan, 0.0, 0.0), (0.0, math.inf, 0.0)])
def test_euler_angles_of_a_capture_become_a_quaternion(angles):
    kind = mavlink.MAVLink_vicon_position_estimate_message
    pose = DECODERS[kind.id](sent(Message(kind, (5, 1.0, 2.0, 3.0, *angles))))
    assert pose[:2] == (5000, (1.0, 2.0, 3.0))
    if math.isfinite(sum(angles)):
        roll, pitch, yaw = angles
        forward = np.reshape(rotation_of(pose.quaternion), (3, 3))[:, 0]
        expected = [math.cos(pitch) * math.cos(yaw), math.cos(pitch) * math.sin(yaw), -math.sin(pitch)]
        np.testing.assert_allclose(forward, expected, atol=1e-6)
        w, x, y, z = pose.quaternion
        assert math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)) == pytest.approx(roll, abs=1e-6)
    else:
        assert all(map(math.isnan, pose.quaternion))


def test_odometry_covariances_are_the_upper_triangles_of_diagonal_matrices():
    pose, velocity = np.array(odometry_covariances(1.0, 2.0, 3.0)).reshape(2, 21)
    full = np.zeros((6, 6))
    full[np.triu_indices(6)] = pose
    np.testing.assert_array_equal(full, np.diag([1.0, 1.0, 1.0, 2.0, 2.0, 2.0]))
    full[np.triu_indices(6)] = velocity
    np.testing.assert_array_equal(full[:3, :3], 3.0 * np.eye(3))
    assert math.isclose(full[3, 3], 1e4)
