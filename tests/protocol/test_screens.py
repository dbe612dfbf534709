"""A screen passes what the reader would accept, refuses what it would refuse, and changes nothing."""

import copy

import numpy as np
import pytest

from onboard.links.ground import GroundLink, GroundLinkConfig
from onboard.links.vehicle import OTHER_VEHICLE, VehicleLink, VehicleLinkConfig
from protocol.endpoint import OTHER_SESSION, Endpoint
from protocol.mavlink import vehicle as wire
from protocol.mavlink.frames import FrameReader, FrameWriter
from protocol.mavlink.signing import SigningClock
from protocol.messages import Pose, TimeSyncRequest

KEY, OTHER_KEY = bytes(range(32)), bytes(32)
POSE = Pose(0, np.zeros(3, np.float32), np.array([1, 0, 0, 0], np.float32))
POSE_TYPE = 66
MS = 1_000_000
TIME_SYNC = TimeSyncRequest(0)


def imu(index: int):
    return wire.encode_imu(index * 5_000, (0.0, 0.0, -9.81), (0.0, 0.0, 0.001 * index), 101_325.0)


def spoilt(frame: bytes, at: int) -> bytes:
    return frame[:at] + bytes((frame[at] ^ 0x40,)) + frame[at + 1 :]


def wrong_forms(frame: bytes) -> list[bytes]:
    """The frame with each byte changed, cut at each length, and with bytes of nothing before it."""
    changed = [spoilt(frame, at) for at in range(len(frame))]
    return [*changed, *(frame[:end] for end in range(len(frame))), b"\0" + frame, b"\xfd" * 40, bytes(600)]


def a_reader(key: bytes | None, first: bytes) -> FrameReader:
    """A reader that has read the first frame."""
    reader = FrameReader([wire.IMU], key, SigningClock())
    assert reader.read(first, 0)
    return reader


@pytest.mark.parametrize("key", [None, KEY], ids=["no key", "key"])
def test_a_frame_reader_screens_as_it_reads(key: bytes | None) -> None:
    writer = FrameWriter(7, 1, key, SigningClock())
    good = [writer.write(imu(index), index * 5 * MS) for index in range(3)]
    wrong = [one for frame in good[1:] for one in wrong_forms(frame)]
    wrong += [FrameWriter(7, 1, OTHER_KEY).write(imu(1), 10 * MS)] if key else []
    wrong += [FrameWriter(7, 1).write(imu(1), 10 * MS)] if key else []
    wrong.append(writer.write(wire.encode_heartbeat(0, 0, 0, False, 0), 10 * MS))
    reader = a_reader(key, good[0])
    before = reader.rejected.copy(), reader.newest_signature_time
    screened = [reader.screen(one) for one in wrong]
    assert (reader.rejected, reader.newest_signature_time) == before
    for one, found in zip(wrong, screened, strict=True):
        assert (found is not None) == bool(a_reader(key, good[0]).read(one, 5 * MS)), one.hex()
    assert [reader.screen(one) for one in good[1:]] == [(wire.IMU, 7)] * 2
    if key:
        assert reader.screen(good[0]) is None, "a recording: its time is not new"


def test_the_vehicles_screen_tells_another_vehicle_from_ours() -> None:
    link = VehicleLink(VehicleLinkConfig())
    ours, other = FrameWriter(7, 1), FrameWriter(8, 1)
    assert link.screen(other.write(imu(0), 0)) == wire.IMU, "before the first one any vehicle may be ours"
    link.receive(ours.write(imu(0), 0), 0)
    assert link.screen(ours.write(imu(1), 0)) == wire.IMU
    assert link.screen(other.write(imu(1), 0)) == OTHER_VEHICLE
    assert link.screen(b"\xfd" * 60) == -1


def test_the_ground_stations_screen_refuses_our_own_echo() -> None:
    link = GroundLink(GroundLinkConfig(system=1))
    heartbeat = wire.encode_heartbeat(0, 0, 0, False, 0)
    assert link.screen(FrameWriter(255, 1).write(heartbeat, 0)) == wire.HEARTBEAT
    assert link.screen(FrameWriter(1, 1).write(heartbeat, 0)) == -1


def test_an_endpoint_screens_as_it_decodes() -> None:
    onboard, offboard = Endpoint("onboard", 1 << 40, KEY), Endpoint("offboard", 1 << 41, KEY)
    older, newer = Endpoint("offboard", 1 << 39, KEY), Endpoint("offboard", 1 << 42, KEY)
    good = [offboard.encode(POSE, index * MS) for index in range(300)]
    forged = [spoilt(good[299], at) for at in range(len(good[299]))]
    wrong = [
        *forged,
        good[0],
        good[298],
        b"",
        bytes(46),
        bytes(1201),
        Endpoint("offboard", 1 << 41, None).encode(POSE, 0),
    ]
    wrong.append(onboard.encode(TIME_SYNC, 0))
    for one in (good[0], good[298]):
        assert onboard.screen(one) == POSE_TYPE
        assert onboard.decode(one, 0) is not None
    before = copy.deepcopy(onboard.statistics)
    assert [onboard.screen(one) for one in wrong] == [-1] * len(wrong)
    assert onboard.screen(good[299]) == onboard.screen(newer.encode(POSE, 0)) == POSE_TYPE
    assert onboard.screen(older.encode(POSE, 0)) == OTHER_SESSION, "the core decides: it may have to be challenged"
    assert onboard.statistics == before
    assert all(onboard.decode(one, 0) is None for one in wrong)
    assert onboard.decode(good[299], 0) is not None
