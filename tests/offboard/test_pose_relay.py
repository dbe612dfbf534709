"""The pose relay: each accepted message, each reason to refuse one, and pymavlink's own reading of the same bytes."""

from math import inf, nan

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from offboard.config import PoseRelayConfig
from offboard.pose_relay import PoseRelay, quaternion_of_euler

MS = 1_000_000
FRD, BODY = mavlink.MAV_FRAME_LOCAL_FRD, mavlink.MAV_FRAME_BODY_FRD


def relay():
    return PoseRelay(PoseRelayConfig(latency_s=0.008, position_limit_m=50.0))


def odometry(position=(0.5, 0.25, -1.0), q=(1.0, 0.0, 0.0, 0.0), frame=FRD, child=BODY, time_us=80_000):
    rates, covariance = (0.1,) * 6, [0.5] * 21
    return mavlink.MAVLink_odometry_message(
        time_us, frame, child, *position, q, *rates, covariance, covariance, 3, 6, 99
    )


def mocap(position=(0.5, 0.25, -1.0), q=(1.0, 0.0, 0.0, 0.0), time_us=80_000):
    return mavlink.MAVLink_att_pos_mocap_message(time_us, q, *position)


def vicon(position=(0.5, 0.25, -1.0), angles=(0.0, 0.0, 0.0), time_us=80_000):
    return mavlink.MAVLink_vicon_position_estimate_message(time_us, *position, *angles)


def packed(message):
    return bytes(message.pack(mavlink.MAVLink(None, 1, 197)))


@pytest.mark.parametrize("message", [odometry(), mocap(), vicon()], ids=["odometry", "mocap", "vicon"])
def test_each_message_is_relayed(message):
    pose = relay().receive(packed(message), 100 * MS)
    assert pose is not None
    assert pose.position_ned_m.tolist() == [0.5, 0.25, -1.0]
    assert pose.quaternion.tolist() == [1.0, 0.0, 0.0, 0.0]
    assert pose.time_ns == 92 * MS


@pytest.mark.parametrize(
    ("datagram", "reason"),
    [
        (b"", "length"),
        (bytes(300), "length"),
        (b"hello, this is no frame", "frame_bytes"),
        (packed(odometry())[:-1], "frame_bytes"),
        (packed(odometry())[:-1] + b"x", "frame_bytes"),
        (packed(mocap()) + packed(mocap(time_us=90_000)), "frame_bytes"),
        (packed(mavlink.MAVLink_heartbeat_message(2, 8, 0, 0, 3, 3)), "message"),
        (packed(odometry(frame=mavlink.MAV_FRAME_GLOBAL)), "frame"),
        (packed(odometry(child=mavlink.MAV_FRAME_LOCAL_NED)), "frame"),
        (packed(odometry(position=(nan, 0, 0))), "not_finite"),
        (packed(mocap(q=(1.0, inf, 0, 0))), "not_finite"),
        (packed(vicon(angles=(0, inf, 0))), "not_finite"),
        (packed(mocap(position=(0, 51.0, 0))), "too_far"),
        (packed(mocap(q=(1.0, 0.2, 0, 0))), "quaternion"),
    ],
)
def test_what_is_refused_is_counted_by_reason(datagram, reason):
    tested = relay()
    assert tested.receive(datagram, 100 * MS) is None
    assert dict(tested.rejected) == {reason: 1}


def test_an_older_pose_is_refused():
    tested = relay()
    assert tested.receive(packed(mocap(time_us=80_000)), 100 * MS) is not None
    assert tested.receive(packed(mocap(time_us=80_000)), 101 * MS) is None
    assert dict(tested.rejected) == {"old": 1}


@settings(max_examples=100, deadline=None)
@given(
    st.lists(st.floats(-40, 40, width=32), min_size=3, max_size=3), st.lists(st.floats(-3, 3), min_size=3, max_size=3)
)
def test_fields_are_those_that_pymavlink_reads(position, angles):
    datagram = packed(odometry(position, quaternion_of_euler(*angles)))
    message = mavlink.MAVLink(None).decode(bytearray(datagram))
    pose = relay().receive(datagram, 100 * MS)
    assert pose is not None
    assert pose.position_ned_m.tolist() == [message.x, message.y, message.z]
    np.testing.assert_allclose(pose.quaternion, message.q, atol=2e-7)


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=300))
def test_any_bytes(data):
    assert relay().receive(data, 100 * MS) is None
