"""The link to offboard: the C core against numpy's, rule by rule. test_link_fuzz.py has the random sequences."""

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from onboard.c.event_text import link_text
from onboard.c.library import Core
from protocol.codec import HEADER
from protocol.endpoint import RATE_BURST, Endpoint
from protocol.feature_config import feature_digest
from protocol.messages import FeatureChunk, Pose, SampleBatch, TimeSyncReply, TimeSyncRequest
from protocol.session import RETIRED_MAX, SEQUENCE_JUMP_MAX, WINDOW
from protocol.statistics import REJECTIONS
from tests.onboard.c import wire
from tests.onboard.c.link_pair import KEY, SESSION, Both, onboard_config, resealed
from tests.onboard.c.parity import octets

MS, S = 1_000_000, 1_000_000_000
POSE = Pose(0, np.zeros(3, np.float32), np.array([1, 0, 0, 0], np.float32))
CHUNK = FeatureChunk(3, 0, 2, bytes(16), b"data")
VECTORS = Path(__file__).resolve().parents[2] / "vectors" / "protocol_v2.json"


def peer(session: int = 1, key: bytes | None = KEY, layout: bytes | None = None) -> Endpoint:
    config = onboard_config()
    return Endpoint("offboard", session, key, config.vehicle_id, layout or feature_digest(config.features))


def shake_hands(both: Both, other: Endpoint, now_ns: int, there_ns: int = 5 * MS, back_ns: int = 5 * MS) -> int:
    """Our request and the peer's reply; its clock is 77 s ahead. Returns the time afterwards."""
    (request,) = both.call("time_sync", now_ns)
    message = other.decode(request, now_ns + there_ns)
    assert isinstance(message, TimeSyncRequest)
    peer_ns = now_ns + there_ns + 77 * S
    reply = other.encode(TimeSyncReply(message.origin_ns, peer_ns, peer_ns), peer_ns)
    both.receive(reply, now_ns + there_ns + back_ns)
    assert both.theirs.endpoint.clock_offset_ns is not None
    return now_ns + there_ns + back_ns


@pytest.mark.parametrize("key", [KEY, None, bytes(16), bytes(64)])
def test_a_session_from_its_start(core: Core, key: bytes | None) -> None:
    both, other = Both(core, key=key), peer(key=key)
    assert both.receive(other.encode(POSE, 0), 10 * MS) == []
    assert both.receive(other.encode(CHUNK, 0), 10 * MS) == []
    now_ns = shake_hands(both, other, 1 * S)
    peer_ns = now_ns + 77 * S
    (pose,) = both.receive(other.encode(Pose(peer_ns, *(POSE.position_ned_m, POSE.quaternion)), peer_ns), now_ns)
    assert pose[2:] == (now_ns, now_ns, 0.0)
    assert both.receive(other.encode(CHUNK, peer_ns), now_ns) == [(3, 0, 2, bytes(16), b"data")]
    assert both.receive(other.encode(CHUNK, 0), now_ns) == [], "sent before this side began"
    assert both.rejected == {"layout": 1, "before_start": 1}
    assert both.call("clock_record", now_ns) == [77.0 * S, 10.0 * MS]
    assert both.call("clock_record", now_ns + 999 * MS) is None
    assert both.call("clock_record", now_ns + 1000 * MS) is not None


def test_what_may_be_a_recording_is_not_used(core: Core) -> None:
    """The layout is known from a challenge; the peer has not answered yet."""
    both, other = Both(core), peer()
    both.receive(other.encode(TimeSyncRequest(5), 5), 5)
    assert both.receive(other.encode(CHUNK, 6), 6) == []
    assert both.receive(other.encode(POSE, 6), 6) == []
    assert both.rejected == {"not_alive": 1}


def test_a_slow_link_makes_poses_uncertain(core: Core) -> None:
    both, other = Both(core), peer()
    now_ns = shake_hands(both, other, S, 30 * MS, 60 * MS)
    peer_ns = now_ns + 77 * S
    (pose,) = both.receive(other.encode(Pose(peer_ns, POSE.position_ned_m, POSE.quaternion), peer_ns), now_ns)
    assert pose[4] == 0.1 * 50_000_000 * 1e-9


def test_a_challenge_is_answered_twice_a_second(core: Core) -> None:
    both, other = Both(core), peer()
    now_ns = shake_hands(both, other, S)
    answers = []
    for step in range(400):
        now_ns += 5 * MS
        both.receive(other.encode(TimeSyncRequest(step), now_ns), now_ns)
        answers += [now_ns for one in both.call("time_sync", now_ns) if one[1] == 67]
    assert len(answers) == 4
    assert all(b - a == 500 * MS for a, b in pairwise(answers))


@pytest.mark.parametrize("restarts", [1, 3])
def test_restarts_of_the_peer(core: Core, restarts: int) -> None:
    both, now_ns = Both(core), S
    old = peer(10)
    recorded = [old.encode(POSE, index) for index in range(20)]
    for datagram in recorded[:10]:
        both.receive(datagram, now_ns)
    now_ns = shake_hands(both, old, now_ns)
    for session in range(11, 11 + restarts):
        other = peer(session)
        assert both.receive(other.encode(POSE, 0), now_ns) == ["restarted"]
        assert both.theirs.endpoint.clock_offset_ns is None
        for datagram in recorded:
            both.receive(datagram, now_ns + 10 * S)
        now_ns = shake_hands(both, other, now_ns + 11 * S)
    assert both.rejected["session"] == 20 * restarts
    assert [text for _, text in both.call("take_events")] == ["offboard restarted"] * restarts
    assert both.call("take_events") == []


def test_a_peer_whose_wall_clock_was_set_back(core: Core) -> None:
    """Rule 3: an older session needs a fresh answer, and silence of the current one."""
    both, older, retired = Both(core), peer(50), peer(99)
    both.receive(retired.encode(POSE, 0), 0)
    now_ns = shake_hands(both, peer(100), S)
    for wait_ns, other in ((999 * MS, older), (10 * S, retired), (10 * S, older)):
        start_ns = now_ns + wait_ns - 10 * MS
        (request,) = both.call("time_sync", start_ns) or both.call("time_sync", start_ns + S)
        origin_ns = HEADER.unpack_from(request)[5]
        both.receive(other.encode(POSE, 0), now_ns + wait_ns)
        for origin in (origin_ns - 1, origin_ns):
            reply = TimeSyncReply(origin, 5, 5)
            both.receive(other.encode(reply, 0), max(origin_ns, now_ns + wait_ns))
        taken = both.theirs.endpoint.peer_session == 50
    assert taken


def test_a_bad_answer_of_an_older_session_is_counted_by_its_own_reason(core: Core) -> None:
    both, older = Both(core), peer(50)
    shake_hands(both, peer(100), S)
    reply = older.encode(TimeSyncReply(1, 2, 3), 0)
    both.receive(resealed(KEY, reply, b"\x94\x01\x02"), 10 * S)
    both.receive(resealed(KEY, reply, b"\x94\x01\x03\x02\xc4\x08" + bytes(8)), 10 * S)
    assert both.rejected == {"body": 1, "value": 1}


def test_the_list_of_retired_sessions_ends_rule_3(core: Core) -> None:
    both = Both(core)
    for session in range(1000, 1000 + RETIRED_MAX):
        both.receive(peer(session).encode(POSE, 0), S)
    for session, taken in ((50, True), (51, False)):
        now_ns = both.theirs.last_received_ns + 5 * S
        (request,) = both.call("time_sync", now_ns)
        reply = TimeSyncReply(HEADER.unpack_from(request)[5], 5, 5)
        both.receive(peer(session).encode(reply, 0), now_ns)
        assert (both.theirs.endpoint.peer_session == session) == taken


def test_the_edges_of_the_replay_window(core: Core) -> None:
    both, datagram = Both(core), peer(5).encode(POSE, 0)
    start = 2**63
    steps = [0, 0, 1, 63, 64, 65, 128, 1, 2, 192, 254, 255, 256, 257, 2, 3, 1, 300, 301, 512, 511, 257, 256, 255, 400]
    steps += [512 + SEQUENCE_JUMP_MAX + 1, 512 + SEQUENCE_JUMP_MAX, 512 + SEQUENCE_JUMP_MAX - WINDOW]
    steps += [512 + SEQUENCE_JUMP_MAX - WINDOW + 1, 600]
    for step in steps:
        both.receive(resealed(KEY, datagram, sequence=start + step), S)
    assert both.rejected == {"too_old": 5, "sequence": 1}
    assert both.theirs.statistics.duplicate == 4


@pytest.mark.parametrize("first", [0, 2**64 - 1, 2**64 - 300, 2**63 - 1])
def test_sequence_numbers_at_the_end_of_their_type(core: Core, first: int) -> None:
    both, datagram, rng = Both(core), peer(5).encode(POSE, 0), np.random.default_rng(first % 97)
    for step in rng.integers(-300, 300, 400):
        both.receive(resealed(KEY, datagram, sequence=(first + int(step)) % 2**64), S)


def test_a_flood_of_genuine_datagrams(core: Core) -> None:
    both, other = Both(core), peer()
    for index in range(2 * RATE_BURST):
        both.receive(other.encode(POSE, 0), S + index // 3 * 100_000)
    assert both.rejected["rate"] > 50


def test_another_layout_is_reported_once_per_session(core: Core) -> None:
    both = Both(core)
    for session in (5, 6):
        other = peer(session, layout=bytes(range(8)))
        for index in range(3):
            both.receive(other.encode(TimeSyncRequest(index), 0), S + index)
            both.receive(other.encode(CHUNK, 0), S + index)
    events = both.call("take_events")
    assert [text.split()[0] for _, text in events] == ["samples", "samples", "offboard"]
    assert both.rejected == {"layout": 6}


def test_events_beyond_the_limit_are_counted(core: Core) -> None:
    both = Both(core)
    for session in range(30):
        both.receive(peer(session).encode(POSE, 0), S)
    events = (core.LinkEvent * 16)()
    assert core.offboard_link_take_events(both.ours.c, events[0]) == 16
    assert {link_text(event) for event in events} == {"offboard restarted"}
    assert both.ours.c.events_lost == 13


def test_the_length_of_a_datagram(core: Core) -> None:
    both, datagram = Both(core), peer(5).encode(POSE, 0)
    for size in range(50):
        both.receive(datagram[:size], S)
        both.receive(bytes(size), S)
    assert both.rejected["length"] == 92
    for size in (0, 1, 2, 3, 1155, 1156, 1157, 1158, 5000):
        both.receive(resealed(KEY, datagram, bytes(size)), S)
    assert both.rejected["length"] == 97
    assert both.rejected["body"] == 1
    assert both.theirs.statistics.duplicate == 3


@pytest.mark.parametrize("vehicle_id", [0, 1, 255, 256, 65535])
def test_the_vehicle_id(core: Core, vehicle_id: int) -> None:
    config = onboard_config().model_copy(update={"vehicle_id": vehicle_id, "status_period_s": 0.033})
    both, layout = Both(core, config), feature_digest(config.features)
    both.call("encode", SampleBatch(0, 0, 1, 0, *(np.zeros(s, np.float32) for s in ((1, 21), (1, 2, 3), (1, 2, 3)))), 9)
    for other in (0, 1, 255, 256, 65535):
        both.receive(Endpoint("offboard", 1 + other, KEY, other, layout).encode(POSE, 0), S)
    assert both.rejected == {"vehicle": 4}


def test_bad_parameters_are_refused(core: Core) -> None:
    layout, endpoint = octets(bytes(8)), core.Endpoint()
    for vehicle_id, key_size in ((-1, 32), (65536, 32), (1, 15), (1, 65), (1, 1)):
        assert not core.endpoint_init(endpoint, 1, octets(bytes(key_size)), key_size, vehicle_id, layout)
    assert core.endpoint_init(endpoint, 2**64 - 1, octets(b""), 0, 65535, layout)


def test_without_a_layout_every_peer_is_heard(core: Core) -> None:
    endpoint, message = core.Endpoint(), core.Message()
    assert core.endpoint_init(endpoint, 1, octets(KEY), 32, 1, octets(bytes(8)))
    other = Endpoint("offboard", 1, KEY, 1, bytes(range(8)))
    for one in (CHUNK, TimeSyncRequest(1), CHUNK):
        datagram = other.encode(one, 0)
        assert core.endpoint_decode(endpoint, octets(datagram), len(datagram), S, message)
        assert not core.endpoint_layout_differs(endpoint)


def test_a_status_or_batch_that_is_not_allowed_uses_no_number(core: Core) -> None:
    both, out = Both(core), core.Datagram()
    status, batch = core.Status(mode=-1), core.SampleBatch(count=9)
    assert not core.offboard_link_status(both.ours.c, status, 0, S, out)
    assert not core.offboard_link_batch(both.ours.c, batch, S, out)
    assert both.ours.c.endpoint.sequence == both.ours.c.endpoint.statistics.sent == 0


@pytest.mark.parametrize("sent_ns", [2**63 - 1, 2**63, 2**64 - 1])
def test_sender_times_beyond_63_bits_and_far_ahead_are_refused(core: Core, sent_ns: int) -> None:
    both, datagram = Both(core), peer(5).encode(POSE, 0)
    for index, when_ns in enumerate((0, sent_ns, 5, 86_500 * S, sent_ns)):
        both.receive(resealed(KEY, datagram, sequence=index, sent_ns=when_ns), S)
    assert both.rejected["value"] == 3


def test_the_published_vectors(core: Core) -> None:
    """Datagrams down are decoded, those up are written to the byte."""
    rows = json.loads(VECTORS.read_text(encoding="utf-8"))["datagrams"]
    for row in rows:
        key, datagram = bytes.fromhex(row["key"] or ""), bytes.fromhex(row["datagram"])
        endpoint, message, out = core.Endpoint(), core.Message(), core.Datagram()
        session = row["session"] if row["direction"] == "up" else SESSION
        assert core.endpoint_init(endpoint, session, octets(key), len(key), row["vehicle_id"], octets(bytes(8)))
        if row["direction"] == "down":
            origin_ns = row["fields"].get("origin_ns", 0)
            core.endpoint_encode_request(endpoint, origin_ns, origin_ns, out)
            assert core.endpoint_decode(endpoint, octets(datagram), len(datagram), origin_ns + 10**9, message)
            assert wire.from_c(core, message)[0].__name__ == row["type"]
            continue
        endpoint.sequence = row["sequence"]
        assert encode(core, endpoint, row, out)
        assert bytes(out.bytes)[: out.size] == datagram
    assert {row["type"] for row in rows} >= {"SampleBatch", "Status", "Pose", "FeatureChunk"}


def encode(core: Core, endpoint: Any, row: dict[str, Any], out: Any) -> bool:
    fields, when_ns = row["fields"], row["sent_ns"]
    if row["type"] == "TimeSyncRequest":
        return bool(core.endpoint_encode_request(endpoint, fields["origin_ns"], when_ns, out))
    kind = {one.__name__: one for one in wire.TYPE_NAMES.values()}[row["type"]]
    values = {name: np.array(value, np.float32) if isinstance(value, list) else value for name, value in fields.items()}
    values |= {name: bytes.fromhex(value) for name, value in fields.items() if isinstance(value, str)}
    function = {"SampleBatch": "endpoint_encode_sample_batch", "Status": "endpoint_encode_status"}[row["type"]]
    return bool(getattr(core, function)(endpoint, wire.to_c(core, kind(**values)), when_ns, out))


def test_every_reason_is_one_of_the_list(core: Core) -> None:
    """The reasons that numpy's core counts by are those that the enumeration of C is made of."""
    for index, name in enumerate(REJECTIONS):
        assert getattr(core, f"REJECTED_{name.upper() or 'NONE'}") == index
