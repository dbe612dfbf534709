"""Nothing is accepted twice: not after a restart, a clock that was set back, or the start of a session."""

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from experiments.flights.scenario import resolve
from onboard.links.ground import GroundLink, GroundLinkConfig
from onboard.links.offboard import DatedPose, OffboardLink
from onboard.links.vehicle import VehicleLink, VehicleLinkConfig
from protocol.endpoint import Endpoint
from protocol.feature_config import feature_digest
from protocol.mavlink import vehicle as wire
from protocol.mavlink.frames import FrameWriter, Message
from protocol.mavlink.signing import SigningClock
from protocol.messages import FeatureChunk, Pose, SampleBatch, TimeSyncReply, TimeSyncRequest
from protocol.session import session_number

KEY = bytes(range(32))
S, MS = 10**9, 10**6
UTC_NS = 1_750_000_000 * S
ARM = Message(
    mavlink.MAVLink_command_long_message,
    (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1, 1, 0),
)
CONFIG = resolve("hover").onboard


def station(utc_ns: int) -> FrameWriter:
    return FrameWriter(255, 190, KEY, SigningClock(utc_ns))


def ground_link(utc_ns: int) -> GroundLink:
    """Of an onboard process that starts at `utc_ns`."""
    return GroundLink(GroundLinkConfig(), KEY, SigningClock(utc_ns))


@pytest.mark.parametrize("after_ms", [1, 400, 30_000, 90_000])
def test_a_recorded_command_arms_no_onboard_that_started_later(after_ms: int) -> None:
    recorded = station(UTC_NS + 10 * MS).write(ARM, 0)
    first = ground_link(UTC_NS)
    first.receive(station(UTC_NS).write(ARM, 0), 0)
    assert len(first.receive(recorded, 10 * MS)) == 1
    assert first.receive(recorded, 11 * MS) == []
    restarted = ground_link(UTC_NS + (10 + after_ms) * MS)
    assert restarted.receive(recorded, 0) == []
    assert restarted.rejected == {"signature_too_old": 1}
    assert len(restarted.receive(station(UTC_NS + (11 + after_ms) * MS).write(ARM, 0), 1 * MS)) == 1


def test_a_recorded_command_is_refused_after_the_clock_was_set_back() -> None:
    recorded = station(UTC_NS).write(ARM, 0)
    set_back = ground_link(UTC_NS - 3600 * S)
    assert set_back.receive(recorded, 0) == []
    assert set_back.rejected == {"signature_from_the_future": 1}


def test_recorded_sensors_reach_no_restarted_onboard() -> None:
    vehicle = FrameWriter(1, 1, KEY, SigningClock(UTC_NS))
    recording = [
        vehicle.write(wire.encode_imu(k * 5000, (0.0, 0.0, -9.81), (0.0, 0.01 * k, 0.0), 101_325.0), k * 5 * MS)
        for k in range(20)
    ]
    restarted = VehicleLink(VehicleLinkConfig(), KEY, SigningClock(UTC_NS + 500 * MS))
    assert not any(restarted.receive(frame, k * 5 * MS) for k, frame in enumerate(recording))
    assert restarted.rejected == {"signature_too_old": 20}


class Offboard:
    """The true trainer, whose datagrams somebody records."""

    def __init__(self, session: int) -> None:
        self.endpoint = Endpoint("offboard", session, KEY, CONFIG.vehicle_id, feature_digest(CONFIG.features))
        self.recording: list[bytes] = []

    def say(self, message: TimeSyncReply | Pose | FeatureChunk, now_ns: int) -> bytes:
        self.recording.append(self.endpoint.encode(message, now_ns))
        return self.recording[-1]


def pose(time_ns: int) -> Pose:
    return Pose(time_ns, np.zeros(3, np.float32), np.array([1, 0, 0, 0], np.float32))


def start(link: OffboardLink, offboard: Offboard, now_ns: int) -> list[object]:
    """The handshake of a start, then a pose and a chunk; returns what onboard takes of them."""
    (request,) = link.time_sync(now_ns)
    asked = offboard.endpoint.decode(request, now_ns)
    assert isinstance(asked, TimeSyncRequest)
    messages = (TimeSyncReply(asked.origin_ns, now_ns, now_ns), pose(now_ns), FeatureChunk(1, 0, 1, bytes(16), b"x"))
    return [one for message in messages for one in link.receive(offboard.say(message, now_ns), now_ns)]


def onboard(wall_ns: int, entropy: int) -> OffboardLink:
    return OffboardLink(CONFIG, session_number(wall_ns, entropy), KEY)


@pytest.mark.parametrize("after_ms", [0, 1, 700])
@pytest.mark.parametrize("peer_first", [False, True])
def test_a_recorded_start_gives_a_restarted_onboard_nothing(after_ms: int, peer_first: bool) -> None:
    offboard = Offboard(session_number(UTC_NS, 5))
    assert [type(one) for one in start(onboard(UTC_NS, 7), offboard, 5 * S)] == [DatedPose, FeatureChunk]
    restarted = onboard(UTC_NS + after_ms * MS, 8)
    now_ns = 5 * S + (after_ms + 1) * MS
    recording = list(offboard.recording)
    if peer_first:
        assert len(start(restarted, offboard, now_ns)) == 2
    else:
        restarted.time_sync(now_ns)
    for _ in range(2):
        assert [one for datagram in recording for one in restarted.receive(datagram, now_ns + 5 * MS)] == []
    if not peer_first:
        assert restarted.endpoint.clock_offset_ns is None


def test_an_onboard_that_restarts_in_the_same_millisecond_is_one_session_at_a_time() -> None:
    """The random part may be lower: then it must answer a challenge. The session before it never returns."""
    trainer = Endpoint("offboard", 9, KEY)
    first, second = (Endpoint("onboard", session_number(UTC_NS, entropy), KEY) for entropy in (900, 100))
    zeros = (np.zeros((1, n), np.float32) for n in (21,))
    batch = SampleBatch(0, 0, 20 * MS, 0, *zeros, *(np.zeros((1, 2, 3), np.float32) for _ in range(2)))
    recording = [first.encode(TimeSyncRequest(k), k) for k in range(3)] + [first.encode(batch, 4)]
    assert all(trainer.decode(datagram, 0) is not None for datagram in recording)
    assert trainer.decode(second.encode(TimeSyncRequest(1), 1), 2 * S) is None
    asked = trainer.challenge(2 * S)
    assert asked is not None
    trainer.encode(asked, 2 * S)
    assert trainer.decode(second.encode(TimeSyncReply(2 * S, 1, 1), 2), 2 * S + MS) is not None
    assert trainer.peer_session == session_number(UTC_NS, 100)
    for now_ns in (2 * S, 60 * S):
        assert not any(trainer.decode(datagram, now_ns) for datagram in recording)
        assert trainer.challenge(now_ns) is None, "a retired session is not even asked"
