"""A bad peer, a flooded link and an attacker: no datagram costs a tick or the vehicle.

Lockstep flights with the real cores of both sides; tests/onboard/test_process.py tests the sockets.
"""

import hashlib
import struct
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import islice, pairwise
from types import SimpleNamespace
from typing import Any

import msgpack
import numpy as np
import pytest

from configs.loader import ConfigError
from experiments.flights.scenario import Choices, resolve
from onboard.config import STATUS_BYTES, SYNC_REPLY_BYTES, SYNC_REQUEST_BYTES, OnboardConfig
from onboard.control.features import random_channel
from onboard.core import OnboardCore
from onboard.flight.modes import FlightMode
from onboard.process import OnboardProcess
from onboard.sampling.sampler import NETWORK_BYTES
from protocol.codec import HEADER, PROTOCOL_VERSION
from protocol.endpoint import DATAGRAMS_PER_STEP_MAX, Endpoint
from protocol.feature_codec import encode_feature_set
from protocol.feature_set import FeatureSet
from protocol.messages import VERSION_MAX, FeatureChunk, Pose, SampleBatch, Status, TimeSyncReply, TimeSyncRequest
from protocol.transfer import split
from runtime.intake import READ_MAX
from runtime.sockets import Stamped
from tests.experiments.link.link_flight import KEY, LEARNING, MS, UP_FOR_NS, Flight, Side, Wire

# --- an attacker with and without the key ----------------------------------------------------------------------------


def sealed(
    message_type: int, body: bytes, session: int, sequence: int, key: bytes | None = KEY, sent_ns: int = 0
) -> bytes:
    """A datagram to onboard made by hand, with content that no message can have. sent_ns: by the peer's clock."""
    signed = HEADER.pack(PROTOCOL_VERSION, message_type, 1, session, sequence, sent_ns) + body
    return signed + hashlib.blake2b(signed, digest_size=16, key=key or b"", person=b"async-dmrac down").digest()


def feature_bytes(change: Callable[[list[Any]], None]) -> bytes:
    """An encoded feature set with something in it changed."""
    fields = msgpack.unpackb(encode_feature_set(features(), "float32"))
    change(fields[5])
    return bytes(msgpack.packb(fields))


def features(gain: float = 1.0, last_layer: float = 0.0, version: int = 1) -> FeatureSet:
    start = random_channel(("position_n", "velocity_n"), np.zeros(2), np.ones(2), (8, 5), np.random.default_rng(1))
    weights = tuple(gain * W for W in start.weights)
    channel = replace(start, weights=weights, last_layer=np.full((6, 3), last_layer))
    return FeatureSet(version, 0, 100, channel, None)


def put_float(value: float) -> Callable[[list[Any]], None]:
    def change(channel: list[Any]) -> None:
        channel[4] = struct.pack("<f", value) + channel[4][4:]

    return change


def put(index: int, value: Any) -> Callable[[list[Any]], None]:
    def change(channel: list[Any]) -> None:
        channel[index] = value

    return change


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (feature_bytes(put_float(float("nan"))), "not_finite"),
        (feature_bytes(put_float(float("inf"))), "not_finite"),
        (feature_bytes(put(0, ["position_n", "altitude"])), "inputs"),
        (feature_bytes(put(3, [8, 6])), "undecodable"),
        (feature_bytes(put(3, [8, 5, 5, 5, 5])), "undecodable"),
        (b"\xc1" * 900, "undecodable"),
        (encode_feature_set(features(gain=1e4), "float32"), "lipschitz"),
        (encode_feature_set(features(last_layer=1e4), "float32"), "weight_norm"),
    ],
)
def test_false_content_with_the_right_key_is_refused_and_offboard_gets_the_reason(data: bytes, reason: str) -> None:
    """Onboard's status contains the reason, offboard logs it, and the sender continues with the next version."""
    config = resolve("hover", Choices("dmrac", 3))
    offboard = Side(config, 7)
    wire = Wire(OnboardCore(config.onboard, 5, KEY), offboard)
    wire.run(0, 0.2)
    bodies = (msgpack.packb((c.version, c.index, c.count, c.digest, c.data)) for c in split(data, 1, 1000))
    sent_ns = 200 * MS + UP_FOR_NS
    waiting = [sealed(65, body, 7, sequence, sent_ns=sent_ns) for sequence, body in enumerate(bodies, 1_000)]
    told: list[str] = []
    for now_ns in range(200 * MS, 500 * MS, 5 * MS):
        out = wire.onboard.tick(now_ns, from_offboard=waiting)
        waiting = []
        for datagram in out.to_offboard:
            offboard.core.receive_onboard(datagram, now_ns + UP_FOR_NS)
        told += [text for _, text in offboard.core.step(now_ns + UP_FOR_NS).events]
    assert told[-1] == f"version 1 refused: {reason}"
    assert wire.onboard.summary()["features"]["version"] == 0


def rubbish(rng: np.random.Generator, genuine: list[bytes]) -> Iterator[bytes]:
    """All bad datagrams without the key: noise, truncated, oversized, another session, version or key, recordings."""
    while True:
        old = genuine[int(rng.integers(len(genuine)))]
        yield rng.bytes(int(rng.integers(0, 2048)))
        yield old
        yield old[: int(rng.integers(len(old)))]
        yield old + bytes(1300)
        yield sealed(66, old[28:-16], int(rng.integers(2**62)), 1, key=bytes(32))
        yield sealed(66, old[28:-16], 99, 1, key=None)
        yield bytes([9]) + old[1:]


def test_a_flood_of_5000_a_second_costs_no_tick_and_no_pose() -> None:
    """25 bad datagrams in each tick, which is 5,000 per second, with the real core in flight."""
    flight = Flight("mrac").with_key().fly(3.0)
    rng = np.random.default_rng(4)
    peer = Endpoint("offboard", 2, None)
    pose = Pose(0, np.zeros(3, np.float32), np.array([1, 0, 0, 0], np.float32))
    flood = rubbish(rng, [peer.encode(pose, i) for i in range(50)])
    tick = flight.onboard.tick

    def flooded(now_ns: int, vehicle: list[bytes], offboard: list[bytes]) -> Any:
        return tick(now_ns, vehicle, [*islice(flood, 25), *offboard])

    flight.onboard.tick = flooded  # type: ignore[method-assign, assignment]
    flight.fly(400 * 0.005)
    assert flight.mode is FlightMode.FLYING
    assert flight.last("pose_age") < 0.1
    assert max(flight.errors_m[-200:]) < 0.3
    assert sum(flight.onboard.summary()["rejected"].values()) > 0.6 * 400 * 25


def test_the_datagrams_of_a_tick_are_limited() -> None:
    """However many datagrams wait in the sockets, the loop reads a limited number, and the core gets fewer."""
    asked: list[int] = []

    def receive(limit: int) -> list[Stamped]:
        asked.append(limit)
        return [Stamped(number.to_bytes(4, "little"), 0) for number in range(limit)]

    socket = SimpleNamespace(receive_stamped=receive, send=lambda datagram: None)
    core = SimpleNamespace(screens=(lambda datagram: 1,) * 3)  # all of them look like messages of one kind
    make: Any = OnboardProcess
    realtime = resolve("hover").onboard.realtime
    sockets = SimpleNamespace(vehicle=socket, offboard=socket, ground=socket)
    process = make(core, realtime, 5 * MS, sockets, None, None, SimpleNamespace(count=0))
    _, from_offboard, _ = process._receive()
    assert 0 < len(from_offboard) <= DATAGRAMS_PER_STEP_MAX == 64
    assert max(asked) == READ_MAX


# --- the budget of the up link ---------------------------------------------------------------------------------------


def assert_within(up: list[tuple[int, int]], budget: float) -> None:
    """No window of time contains more than the budget and one burst; `up`: (ns, bytes) of each datagram."""
    times, sizes = (np.array(column) for column in zip(*up, strict=True))
    total = np.concatenate([[0], np.cumsum(sizes)])
    burst = 2 * 1200 + 300
    for first in range(len(times)):
        spans_s = (times[first:] - times[first]) * 1e-9
        assert (total[first + 1 :] - total[first] <= burst + budget * spans_s).all()


@pytest.mark.parametrize(("budget", "status_s"), [(1_500.0, 0.2), (6_000.0, 0.1)])
def test_the_up_link_stays_within_its_budget(budget: float, status_s: float) -> None:
    """Samples, status and time sync with all headers, in every window; the newest samples are sent, gaps are marked."""
    narrow = (
        *LEARNING,
        f"onboard.samples.budget_bytes_s={budget}",
        f"onboard.status_period_s={status_s}",
        "onboard.samples.rate_hz=100.0",
    )
    flight = Flight("mrac", assignments=narrow)
    listener = Endpoint("offboard", 9, None)
    batches: list[tuple[int, SampleBatch]] = []
    tick = flight.onboard.tick

    def overheard(now_ns: int, *datagrams: Any) -> Any:
        out = tick(now_ns, *datagrams)
        messages = (listener.decode(datagram, now_ns) for datagram in out.to_offboard)
        batches.extend((now_ns, message) for message in messages if isinstance(message, SampleBatch))
        return out

    flight.onboard.tick = overheard  # type: ignore[method-assign, assignment]
    flight.fly(6.0)
    assert_within(flight.up, budget)
    assert sum(size for _, size in flight.up) > 0.8 * budget * 3.0, "and what there is is used"
    assert flight.onboard.summary()["samples"]["dropped"] > 0
    ages_s = [(now_ns - batch.time_ns) * 1e-9 for now_ns, batch in batches[3:]]
    assert max(ages_s) < 0.3, "the newest samples are kept"
    jumps = [later.first_index - sooner.first_index for (_, sooner), (_, later) in pairwise(batches[3:])]
    assert min(jumps) >= 1
    assert max(jumps) > batches[-1][1].signals.shape[0], "what is missing shows as a jump of the index"


def test_the_budget_holds_with_a_peer_that_restarts_and_sends_requests_without_end() -> None:
    assignments = ("onboard.samples.budget_bytes_s=1500.0", "onboard.status_period_s=0.2")
    onboard = OnboardCore(resolve("hover", Choices("pid", 3, None, assignments)).onboard, 5, KEY)
    up: list[tuple[int, int]] = []
    for tick in range(2_000):
        now_ns = tick * 5 * MS
        peer = Endpoint("offboard", tick + 1, KEY)
        asked = [peer.encode(TimeSyncRequest(now_ns), now_ns)]
        up += [(now_ns, len(sent) + NETWORK_BYTES) for sent in onboard.tick(now_ns, from_offboard=asked).to_offboard]
    assert_within(up, 1_500.0)
    assert len(up) > 100, "but it is answered"


def test_a_budget_that_status_and_time_sync_alone_exceed_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"samples\.budget_bytes_s 1500: status_period_s 0\.1 .*may take 2680 B/s"):
        resolve("hover", Choices(assignments=("onboard.samples.budget_bytes_s=1500.0",)))
    most, newest, count, endpoint = 2**32 - 1, VERSION_MAX, 2**63 - 1, Endpoint("onboard", 1, KEY)
    status = Status(9, newest, newest, bytes(8), newest, 9, count, count, most, count, count, count)
    longest = (status, TimeSyncRequest(count), TimeSyncReply(count, count, count))
    stated = (STATUS_BYTES, SYNC_REQUEST_BYTES, SYNC_REPLY_BYTES)
    sizes = [len(endpoint.encode(message, 0)) + NETWORK_BYTES for message in longest]
    assert sizes[1:] == list(stated[1:])
    assert 0.9 * STATUS_BYTES < sizes[0] <= STATUS_BYTES


def test_the_hand_made_datagrams_are_valid() -> None:
    """An unchanged hand-made datagram is accepted; otherwise the tests above would test nothing."""
    onboard = Endpoint("onboard", 5, KEY)
    chunk = split(encode_feature_set(features(), "float32"), 1, 1000)[0]
    body = msgpack.packb((chunk.version, chunk.index, chunk.count, chunk.digest, chunk.data))
    assert onboard.decode(sealed(65, body, 7, 3), 0) == chunk
    assert isinstance(chunk, FeatureChunk)
    assert OnboardConfig.model_fields["samples"]
