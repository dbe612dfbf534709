"""Pose relay: motion capture in, poses out; refused datagrams are counted."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from offboard.config import PoseRelayConfig
from offboard.links.pose_relay import FROZEN_POSES, REASONS, PoseRelay
from protocol.mavlink.frames import FrameWriter
from protocol.mavlink.motion_capture import encode_odometry, odometry_covariances
from protocol.mavlink.signing import SigningClock

MS = 1_000_000
S = 1_000_000_000
HALF = math.sqrt(0.5)


def relay(latency_s: float = 0.0) -> PoseRelay:
    return PoseRelay(PoseRelayConfig(latency_s=latency_s, position_limit_m=50.0))


def packed(message: mavlink.MAVLink_message) -> bytes:
    return bytes(message.pack(mavlink.MAVLink(None, srcSystem=7)))


def odometry(time_us: int = 1000, x: float = 0.5, q: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0), **over: int) -> bytes:
    frame = over.get("frame", mavlink.MAV_FRAME_LOCAL_FRD)
    child = over.get("child", mavlink.MAV_FRAME_BODY_FRD)
    return packed(
        mavlink.MAVLink_odometry_message(
            time_us, frame, child, x, -0.25, -1.0, list(q), 0, 0, 0, 0, 0, 0, [0.0] * 21, [0.0] * 21, 0, 6, 100
        )
    )


def texts(relay_: PoseRelay) -> list[str]:
    return [text for _, text in relay_.take_events()]


def test_three_kinds_of_messages_give_the_same_pose() -> None:
    mocap = mavlink.MAVLink_att_pos_mocap_message(1000, [HALF, 0.0, 0.0, HALF], 0.5, -0.25, -1.0)
    vicon = mavlink.MAVLink_vicon_position_estimate_message(1000, 0.5, -0.25, -1.0, 0.0, 0.0, math.pi / 2)
    for datagram in (odometry(q=(HALF, 0.0, 0.0, HALF)), packed(mocap), packed(vicon)):
        pose = relay().receive(datagram, 5 * MS)
        assert pose is not None
        assert pose.position_ned_m == pytest.approx([0.5, -0.25, -1.0])
        assert pose.quaternion == pytest.approx([HALF, 0.0, 0.0, HALF], abs=1e-6)
        assert pose.time_ns == 5 * MS


@pytest.mark.parametrize(
    ("datagram", "reason"),
    [
        (b"", "length"),
        (b"x" * 400, "length"),
        (b"\xfd\x00", "frame_bytes"),
        (odometry()[:-3], "frame_bytes"),
        (odometry(x=float("nan")), "not_finite"),
        (odometry(q=(float("inf"), 0.0, 0.0, 0.0)), "not_finite"),
        (odometry(x=60.0), "too_far"),
        (odometry(q=(0.5, 0.0, 0.0, 0.0)), "quaternion"),
        (odometry(frame=mavlink.MAV_FRAME_BODY_FRD), "frame"),
        (odometry(child=mavlink.MAV_FRAME_LOCAL_NED), "frame"),
        (packed(mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 0, 3)), "message"),
    ],
)
def test_refused_datagrams_are_counted_by_reason(datagram: bytes, reason: str) -> None:
    relay_ = relay()
    assert relay_.receive(datagram, 5 * MS) is None
    assert relay_.rejected == {reason: 1}
    assert texts(relay_) == [f"motion capture: {REASONS[reason]}, pose ignored"]
    assert relay_.receive(odometry(), 6 * MS) is not None


def test_a_frozen_capture_is_not_relayed_until_it_moves_again() -> None:
    relay_ = relay()
    relayed = [relay_.receive(odometry(10_000 * k, x=0.7), 10 * k * MS) is not None for k in range(1, 41)]
    assert relayed == [True] * FROZEN_POSES + [False] * (40 - FROZEN_POSES)
    assert relay_.rejected == {"frozen": 40 - FROZEN_POSES}
    assert texts(relay_) == ["motion capture: repeats one pose (frozen), pose ignored"]
    assert relay_.receive(odometry(410_000, x=0.70001), 410 * MS) is not None


def test_each_reason_is_reported_once_a_second() -> None:
    relay_ = relay()
    for k in range(250):
        assert relay_.receive(odometry(10_000 * k, x=math.nan), 10 * k * MS) is None
    assert [when // MS for when, _ in relay_.take_events()] == [0, 1000, 2000]


@settings(max_examples=60, deadline=None)
@given(st.binary(max_size=300))
def test_no_bytes_raise(datagram: bytes) -> None:
    relay_ = relay()
    relay_.receive(datagram, MS)
    damaged = bytearray(odometry())
    for place, byte in enumerate(datagram[: len(damaged)]):
        damaged[place] ^= byte & 1
    relay_.receive(bytes(damaged), MS)


def test_a_late_datagram_keeps_the_time_of_its_pose() -> None:
    relay_ = relay(latency_s=0.004)
    delays_ms = (3, 1, 9, 1, 14, 2)
    times = []
    for number, delay_ms in enumerate(delays_ms):
        capture_ms = 1000 + 20 * number
        pose = relay_.receive(odometry(capture_ms * 1000), (capture_ms + 500 + delay_ms) * MS)
        assert pose is not None
        times.append(pose.time_ns / MS - capture_ms - 500 + 4)
    assert times == [3, 1, 3, 1, 1, 1], "the second least delay counts, but no pose is later than its arrival"


def test_old_poses_are_dropped_and_a_restarted_capture_is_followed() -> None:
    relay_ = relay()
    assert relay_.receive(odometry(100_000), 1000 * MS) is not None
    assert relay_.receive(odometry(80_000), 1001 * MS) is None
    assert relay_.receive(odometry(100_000), 1002 * MS) is None
    assert relay_.rejected == {"old": 2}
    texts(relay_)
    pose = relay_.receive(odometry(5_000), 2000 * MS)
    assert pose is not None
    assert pose.time_ns == 2000 * MS
    assert texts(relay_) == ["motion capture: its clock stepped by -1.095 s; mapped again"]


def test_a_recording_beside_the_living_capture_moves_no_clock() -> None:
    relay_ = relay()
    for k in range(1, 200):
        assert relay_.receive(odometry(10_000 * k + 7_000_000, x=1e-3 * k), 10 * k * MS) is not None
        assert relay_.receive(odometry(10_000 * k + 1_000_000, x=0.3), (10 * k + 1) * MS) is None
        assert relay_.receive(odometry(10_000 * k + 90_000_000, x=0.3), (10 * k + 2) * MS) is None
    assert relay_.clock_steps == 0
    assert relay_.rejected == {"other_clock": 2 * 199}


def test_a_clock_that_steps_far_in_flight_costs_a_third_of_a_second() -> None:
    relay_ = relay()
    used = [
        relay_.receive(odometry(10_000 * k + (3_600_000_000 if k >= 50 else 0), x=1e-3 * k), 10 * k * MS) is not None
        for k in range(1, 200)
    ]
    assert [k for k, one in enumerate(used, 1) if not one] == list(range(50, 79))
    assert relay_.clock_steps == 1


@pytest.mark.parametrize("ahead_ms", [60, 200, 499])
def test_a_lone_stamp_ahead_is_refused_and_changes_nothing(ahead_ms: int) -> None:
    relay_ = relay()
    for k in range(200):
        ahead = ahead_ms if k == 100 else 0
        pose = relay_.receive(odometry((10 * k + ahead) * 1000, x=1e-3 * k), (10 * k + 700) * MS)
        assert (pose is None) == (k == 100)
        assert pose is None or pose.time_ns == (10 * k + 700) * MS
    assert relay_.rejected == {"ahead": 1}


def test_a_capture_clock_that_jumps_ahead_costs_two_poses() -> None:
    relay_ = relay()
    times = [
        relay_.receive(odometry((10 * k + (200 if k >= 50 else 0)) * 1000, x=1e-3 * k), (10 * k + 700) * MS)
        for k in range(100)
    ]
    assert [k for k, pose in enumerate(times) if pose is None] == [50, 51]
    assert all(pose is None or pose.time_ns == (10 * k + 700) * MS for k, pose in enumerate(times))


@pytest.mark.parametrize("stall_ms", [10, 34, 50])
def test_a_stall_changes_no_time_of_a_pose(stall_ms: int) -> None:
    relay_ = relay()
    for k in range(300):
        late = stall_ms if k % 30 == 29 else 0
        pose = relay_.receive(odometry(10_000 * k, x=1e-3 * k), (10 * k + 1 + late) * MS)
        assert pose is not None
        assert pose.time_ns == (10 * k + 1) * MS


KEY = bytes(range(32))
UTC_NS = 1_700_000_000 * S


def pose_of(time_ns: int, north_m: float = 1.0):
    pose = ((north_m, 2.0, -1.0), (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    return encode_odometry(time_ns // 1000, *pose, odometry_covariances(1e-6, 1e-6, 1e-4))


def signed(time_ns: int, key: bytes | None = KEY) -> bytes:
    """A frame of another motion capture, signed at `time_ns` on its clock."""
    return FrameWriter(1, 197, key, SigningClock(UTC_NS)).write(pose_of(time_ns), time_ns)


def keyed_relay(utc_ns: int = UTC_NS) -> PoseRelay:
    config = PoseRelayConfig(latency_s=0.0, position_limit_m=50.0)
    return PoseRelay(config, KEY, SigningClock(utc_at_first_use_ns=utc_ns))


def test_with_a_key_only_new_signed_poses_are_relayed() -> None:
    capture = FrameWriter(1, 197, KEY, SigningClock(UTC_NS))
    relay = keyed_relay()
    sent = [capture.write(pose_of(10 * index * MS, 0.01 * index), 10 * index * MS) for index in range(1, 4)]
    assert relay.receive(signed(1 * MS, key=None), 0) is None
    assert relay.receive(signed(1 * MS, key=bytes(32)), 0) is None
    assert relay.receive(sent[0], 11 * MS) is not None
    assert relay.receive(sent[1], 21 * MS) is not None
    assert relay.receive(sent[0], 22 * MS) is None
    assert relay.rejected == {"unsigned": 1, "signature": 1, "signature_replayed": 1}
    assert relay.take_events()[0][1] == "motion capture: the signature is missing, wrong or repeated, pose ignored"
    assert relay.screen(sent[2]) == 331
    assert [relay.screen(one) for one in (sent[1], signed(0, key=None), b"", sent[2][:-1] + b"?")] == [-1] * 4


def test_a_recording_of_another_day_is_refused() -> None:
    relay = keyed_relay(UTC_NS + 86_400 * S)
    assert relay.receive(signed(1 * MS), 1 * MS) is None
    assert relay.rejected == {"signature_too_old": 1}
