"""Round-trip laws: what one side encodes, the other side decodes to the same values, within the wire's resolution."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from protocol.geometry import rotation_of
from protocol.mavlink import vehicle as wire
from protocol.mavlink.frames import FrameReader, FrameWriter, Message
from protocol.mavlink.motion_capture import DECODERS, encode_odometry, odometry_covariances

approx = pytest.approx
number = st.floats(-1e4, 1e4, width=32)
pair, vector, quaternion = (st.tuples(*[number] * size) for size in (2, 3, 4))
fraction = st.floats(0.0, 1.0, width=32)
fractions = st.tuples(*[fraction] * 4)
time_us = st.integers(0, 2**31).map(lambda milliseconds: milliseconds * 1000)
covariances = st.just(odometry_covariances(1.0, 2.0, 3.0))
DECODE_ODOMETRY = DECODERS[mavlink.MAVLINK_MSG_ID_ODOMETRY]
LAWS = {
    "imu": (
        (wire.encode_imu, time_us, vector, vector, st.floats(3e4, 1.2e5)),
        (wire.decode_imu, lambda t, a, g, p: (t * 1000, a, g, approx(p, rel=1e-7))),
    ),
    "flow": (
        (wire.encode_flow, time_us, st.integers(1000, 500_000).map(lambda us: us * 1e-6), pair, vector, st.just(9)),
        (wire.decode_flow, lambda t, s, flow, turn, quality: (t * 1000, approx(s), *flow, *turn[:2], quality)),
    ),
    "range": (
        (wire.encode_range, time_us, st.floats(0.0, 600.0), st.just((0.44, 4.0)), st.just(0.02)),
        (wire.decode_range, lambda t, distance, limits, noise: (t * 1000, approx(distance, abs=0.00501), 0.44)),
    ),
    "battery": (
        (wire.encode_battery, st.floats(0.001, 60.0), st.just(3.0), st.just(9.0), fraction),
        (lambda f: wire.decode_battery(f, 7), lambda v, a, mah, r: (7, approx(v, abs=6e-4), approx(r, abs=6e-3))),
    ),
    "battery unknown": (
        (wire.encode_battery, st.just(0.0), st.just(0.0), st.just(0.0), st.just(-1.0)),
        (lambda f: wire.decode_battery(f, 7), lambda *_: (7, 0.0, -1.0)),
    ),
    "system status": (
        (wire.encode_system_status, st.just(1), st.just(1), st.floats(0.001, 60.0), fraction),
        (
            lambda f: wire.decode_system_status(f, 7),
            lambda p, h, v, r: (7, approx(v, abs=6e-4), approx(r, abs=6e-3)),
        ),
    ),
    "system status unknown": (
        (wire.encode_system_status, st.just(1), st.just(1), st.just(0.0), st.just(-1.0)),
        (lambda f: wire.decode_system_status(f, 7), lambda *_: (7, 0.0, -1.0)),
    ),
    "motors": (
        (wire.encode_motors, time_us, fractions, st.booleans()),
        (wire.decode_motors, lambda t, values, armed: (values, armed)),
    ),
    "odometry": (
        (encode_odometry, time_us, vector, quaternion, vector, covariances),
        (DECODE_ODOMETRY, lambda t, position, attitude, *_: (t * 1000, position, attitude)),
    ),
}


def sent(message):
    """The fields of a message after its way through a frame."""
    (frame,) = FrameReader([message.kind.id]).read(FrameWriter(1, 1).write(message, 0), 0)
    return frame.fields


@pytest.mark.parametrize("name", LAWS)
@settings(max_examples=60, deadline=None, derandomize=True)
@given(data=st.data())
def test_decoding_inverts_encoding(name, data):
    (encode, *strategies), (decode, expected) = LAWS[name]
    values = [data.draw(strategy) for strategy in strategies]
    assert decode(sent(encode(*values))) == expected(*values)


@pytest.mark.parametrize("angles", [(0.3, -0.4, 1.1), (math.nan, 0.0, 0.0), (0.0, math.inf, 0.0)])
def test_euler_angles_of_a_capture_become_a_quaternion(angles):
    kind = mavlink.MAVLink_vicon_position_estimate_message
    pose = DECODERS[kind.id](sent(Message(kind, (5, 1.0, 2.0, 3.0, *angles))))
    assert pose[:2] == (5000, (1.0, 2.0, 3.0))
    if not math.isfinite(sum(angles)):
        assert all(map(math.isnan, pose.quaternion))
        return
    roll, pitch, yaw = angles
    forward, right, _ = np.reshape(rotation_of(pose.quaternion), (3, 3)).T
    expected = [math.cos(pitch) * math.cos(yaw), math.cos(pitch) * math.sin(yaw), -math.sin(pitch)]
    np.testing.assert_allclose(forward, expected, atol=1e-6)
    assert right[2] == approx(math.sin(roll) * math.cos(pitch), abs=1e-6)


def test_odometry_covariances_are_the_upper_triangles_of_diagonal_matrices():
    full = np.zeros((2, 6, 6))
    covariances = odometry_covariances(1.0, 2.0, 3.0).received[:42]  # behind them: frames, estimator, quality
    full[:, *np.triu_indices(6)] = np.reshape(covariances, (2, 21))
    np.testing.assert_array_equal(full[0], np.diag([1.0, 1.0, 1.0, 2.0, 2.0, 2.0]))
    np.testing.assert_array_equal(full[1], np.diag([3.0, 3.0, 3.0, 1e4, 1e4, 1e4]))
