import hashlib
from collections.abc import Callable

import numpy as np
import pytest

from protocol.codec import HEADER, encode_body
from protocol.endpoint import RATE_BURST, Endpoint
from protocol.messages import Message, Pose, TimeSyncReply, TimeSyncRequest
from protocol.session import RETIRED_MAX, WINDOW, session_number

KEY = bytes(range(32))
MS = 1_000_000
S = 1_000_000_000
POSE = Pose(0, np.zeros(3, np.float32), np.array([1, 0, 0, 0], np.float32))


def ends(key: bytes | None = KEY) -> tuple[Endpoint, Endpoint]:
    return Endpoint("onboard", 1 << 40, key), Endpoint("offboard", 1 << 41, key)


def poses(offboard: Endpoint, count: int, period_ns: int = 10 * MS) -> list[bytes]:
    return [offboard.encode(POSE, i * period_ns) for i in range(count)]


@pytest.mark.parametrize("key", [KEY, None], ids=["key", "no key"])
def test_messages_get_through(key: bytes | None, all_messages: tuple[tuple[Message, ...], tuple[Message, ...]]) -> None:
    onboard, offboard = ends(key)
    onboard.encode(TimeSyncRequest(5 * S), 5 * S)  # the reply among the messages answers this one
    for sender, receiver, messages in ((onboard, offboard, all_messages[0]), (offboard, onboard, all_messages[1])):
        for message in messages:
            datagram = sender.encode(message, 6 * S)
            assert len(datagram) <= 1200
            assert type(receiver.decode(datagram, 6 * S)) is type(message)
        assert receiver.statistics.received == len(messages)
        assert receiver.statistics.rejected.total() == 0
    assert offboard.peer_session == 1 << 40


def forge(onboard: Endpoint, offboard: Endpoint, change: Callable[[bytearray], None], key: bytes | None) -> None:
    """Give onboard a datagram of offboard that was changed and, if `key` is given, signed again."""
    datagram = bytearray(offboard.encode(POSE, S))
    change(datagram)
    if key is not None:
        person = b"async-dmrac down"
        datagram[-16:] = hashlib.blake2b(datagram[:-16], digest_size=16, key=key, person=person).digest()
    assert onboard.decode(bytes(datagram), S) is None


def put(at: int, value: int) -> Callable[[bytearray], None]:
    def change(datagram: bytearray) -> None:
        datagram[at] = value

    return change


def cut(datagram: bytearray) -> None:
    del datagram[40:]


def grow(datagram: bytearray) -> None:
    datagram.extend(b"\x00" * 1200)


def truncate_body(datagram: bytearray) -> None:
    del datagram[-20:-16]


def not_unit(datagram: bytearray) -> None:
    datagram[-17] = 0x40


@pytest.mark.parametrize(
    ("change", "key", "reason"),
    [
        (cut, None, "length"),
        (grow, None, "length"),
        (put(0, 1), KEY, "version"),
        (put(1, 0), KEY, "type"),
        (put(1, 1), KEY, "type"),
        (put(2, 9), KEY, "vehicle"),
        (put(-1, 0), None, "mac"),
        (put(35, 1), None, "mac"),
        (put(0, 2), bytes(32), "mac"),
        (put(0, 2), b"", "mac"),
        (truncate_body, None, "mac"),
        (truncate_body, KEY, "body"),
        (put(28, 0xC1), KEY, "body"),
        (not_unit, KEY, "value"),
    ],
)
def test_invalid_datagrams_are_counted_by_reason(
    change: Callable[[bytearray], None], key: bytes | None, reason: str
) -> None:
    onboard, offboard = ends()
    forge(onboard, offboard, change, key)
    assert dict(onboard.statistics.rejected) == {reason: 1}
    assert onboard.decode(offboard.encode(POSE, S), S) is not None


def test_a_datagram_sent_back_to_its_sender_is_not_genuine() -> None:
    onboard, other = Endpoint("onboard", 5, KEY), Endpoint("onboard", 6, KEY)
    datagram = onboard.encode(TimeSyncRequest(1), 1)
    assert other.decode(datagram, 1) is None
    # the direction is part of the MAC, also for a type that is sent down
    header = HEADER.pack(2, 66, 1, 1 << 41, 0, 0)
    signed = header + encode_body(POSE)
    mac = hashlib.blake2b(signed, digest_size=16, key=KEY, person=b"async-dmrac up").digest()
    assert onboard.decode(signed + mac, 1) is None
    assert onboard.statistics.rejected["mac"] == 1


def test_a_role_sends_only_its_own_messages() -> None:
    onboard, _ = ends()
    with pytest.raises(ValueError, match="is not sent in this direction"):
        onboard.encode(POSE, 0)


@pytest.mark.parametrize(
    ("session", "key", "vehicle_id"), [(-1, KEY, 1), (2**64, KEY, 1), (1, b"short", 1), (1, KEY, 65536)]
)
def test_bad_parameters_raise(session: int, key: bytes, vehicle_id: int) -> None:
    with pytest.raises(ValueError):
        Endpoint("onboard", session, key, vehicle_id)


def test_loss_reordering_and_duplicates_are_counted() -> None:
    onboard, offboard = ends()
    datagrams = poses(offboard, 10)
    for index in (0, 1, 4, 3, 4, 8, 8, 1, 9):
        onboard.decode(datagrams[index], index * 10 * MS)
    statistics = onboard.statistics
    assert (statistics.received, statistics.lost, statistics.duplicate, statistics.reordered) == (6, 4, 3, 1)
    assert statistics.loss_fraction == pytest.approx(0.4)
    assert statistics.longest_gap_ns == 50 * MS
    assert statistics.age_ns(100 * MS) == 10 * MS


def test_a_late_start_is_not_a_loss_but_an_earlier_datagram_still_counts() -> None:
    onboard, offboard = ends()
    datagrams = poses(offboard, 6)
    onboard.decode(datagrams[5], 0)
    assert onboard.statistics.lost == 0
    assert onboard.decode(datagrams[3], 0) is not None
    assert onboard.statistics.lost == 1


def test_the_window_ends() -> None:
    onboard, offboard = ends()
    datagrams = poses(offboard, WINDOW + 2)
    onboard.decode(datagrams[WINDOW + 1], 0)
    assert onboard.decode(datagrams[2], 0) is not None
    assert onboard.decode(datagrams[2], 0) is None
    assert onboard.decode(datagrams[1], 0) is None
    assert onboard.statistics.rejected["too_old"] == 1
    assert onboard.statistics.duplicate == 1


def test_replaying_a_complete_recording_changes_nothing() -> None:
    onboard, offboard = ends()
    datagrams = poses(offboard, 1000)
    assert all(onboard.decode(datagram, i * 10 * MS) for i, datagram in enumerate(datagrams))
    assert not any(onboard.decode(datagram, 10 * S + i * MS) for i, datagram in enumerate(datagrams))


def test_a_restarted_peer_is_accepted_and_its_old_session_is_not() -> None:
    onboard, old = ends()
    recording = poses(old, 20)
    for datagram in recording[:10]:
        onboard.decode(datagram, 0)
    new = Endpoint("offboard", (1 << 41) + 1, KEY)
    assert onboard.decode(new.encode(POSE, 0), 0) is not None
    assert onboard.peer_session == (1 << 41) + 1
    assert onboard.statistics.sessions == 2
    for later_ns in (0, 100 * S):
        assert not any(onboard.decode(datagram, later_ns) for datagram in recording)
    assert onboard.statistics.rejected["session"] == 40
    assert onboard.decode(new.encode(POSE, 0), 0) is not None


def test_a_peer_whose_wall_clock_was_set_back_returns_by_answering() -> None:
    onboard, offboard = ends()
    onboard.decode(offboard.encode(POSE, 0), 0)
    back = Endpoint("offboard", 77, KEY)
    assert onboard.decode(back.encode(POSE, 0), 5 * S) is None, "an older session is not accepted without an answer"
    onboard.encode(TimeSyncRequest(5 * S), 5 * S)
    reply = TimeSyncReply(5 * S, 1, 1)
    assert onboard.decode(back.encode(reply, 1), 5 * S + MS) is not None
    assert onboard.decode(back.encode(POSE, 1), 5 * S + MS) is not None
    assert onboard.decode(offboard.encode(POSE, 0), 6 * S) is None, "the session it replaced is retired"


def test_an_older_session_does_not_displace_a_living_one() -> None:
    onboard, offboard = ends()
    second = Endpoint("offboard", 77, KEY)
    for tick in range(20):
        now = tick * 100 * MS
        onboard.decode(offboard.encode(POSE, now), now)
        onboard.encode(TimeSyncRequest(now), now)
        assert onboard.decode(second.encode(TimeSyncReply(now, now, now), now), now + MS) is None
    assert onboard.peer_session == 1 << 41


def test_retired_sessions_are_bounded_and_none_is_accepted_again() -> None:
    onboard, _ = ends()
    for session in range(100, 100 + RETIRED_MAX + 10):
        assert onboard.decode(Endpoint("offboard", session, KEY).encode(POSE, 0), session * 10 * MS) is not None
    now = 1000 * S
    onboard.encode(TimeSyncRequest(now), now)
    first = Endpoint("offboard", 100, KEY)
    assert onboard.decode(first.encode(TimeSyncReply(now, 1, 1), 1), now) is None


def test_session_numbers_grow_with_the_wall_clock() -> None:
    early, late = session_number(1_700_000_000 * S, 2**20 - 1), session_number(1_700_000_000 * S + MS, 0)
    assert early < late < 2**64
    assert session_number(0, 1) != session_number(0, 2)


def exchange(onboard: Endpoint, offboard: Endpoint, now_ns: int, offset_ns: int, there_ns: int, back_ns: int) -> None:
    request = offboard.decode(onboard.encode(TimeSyncRequest(now_ns), now_ns), now_ns + there_ns + offset_ns)
    assert isinstance(request, TimeSyncRequest)
    stamp = now_ns + there_ns + offset_ns
    reply = offboard.encode(TimeSyncReply(request.origin_ns, stamp, stamp + 50_000), stamp + 50_000)
    onboard.decode(reply, now_ns + there_ns + 50_000 + back_ns)


def test_the_clock_offset_is_that_of_the_shortest_round_trip() -> None:
    onboard, offboard = ends()
    assert onboard.clock_offset_ns is None
    rng = np.random.default_rng(1)
    for second in range(12):
        there, back = (8 * MS + int(d) for d in rng.exponential(5 * MS, size=2))
        exchange(onboard, offboard, second * S, 1234 * S, there, back)
    exchange(onboard, offboard, 13 * S, 1234 * S, 8 * MS, 8 * MS)
    assert onboard.clock_offset_ns == 1234 * S
    assert onboard.round_trip_ns == 16 * MS
    onboard.decode(offboard.encode(POSE, 1234 * S + 20 * S), 20 * S + 9 * MS)
    assert onboard.statistics.delay_ns == 9 * MS
    for pose in range(200):
        onboard.decode(offboard.encode(POSE, (1255 + pose) * S), (21 + pose) * S + 70 * MS)
    assert onboard.statistics.delay_mean_ns == pytest.approx(70 * MS, rel=0.01)


def test_a_jump_of_either_clock_is_detected_at_once() -> None:
    onboard, offboard = ends()
    for second in range(5):
        exchange(onboard, offboard, second * S, 10 * S, 5 * MS, 5 * MS)
    exchange(onboard, offboard, 6 * S, 9 * S, 15 * MS, 5 * MS)
    assert onboard.clock_offset_ns == pytest.approx(9 * S, abs=6 * MS)
    assert onboard.clock_jumps == 1


def test_the_own_clock_may_jump_in_both_directions() -> None:
    onboard, offboard = ends()
    exchange(onboard, offboard, 100 * S, 10 * S, 5 * MS, 5 * MS)
    for now in (5 * S, 900 * S, 0):
        assert onboard.decode(offboard.encode(POSE, 200 * S), now) is not None
        exchange(onboard, offboard, now, 10 * S + now, 5 * MS, 5 * MS)
    assert onboard.clock_offset_ns == 10 * S
    assert onboard.statistics.rejected.total() == 0


def test_an_unrequested_replayed_or_late_reply_changes_no_offset() -> None:
    onboard, offboard = ends()
    assert onboard.decode(offboard.encode(TimeSyncReply(5, 900, 900), 900), 6) is None
    onboard.encode(TimeSyncRequest(10), 10)
    assert onboard.decode(offboard.encode(TimeSyncReply(10, 900, 900), 900), 10 + 3 * S) is None
    assert onboard.clock_offset_ns is None
    assert onboard.statistics.rejected["time_sync"] == 2


def test_a_restarted_peer_must_answer_again() -> None:
    onboard, offboard = ends()
    exchange(onboard, offboard, S, 10 * S, MS, MS)
    assert onboard.clock_offset_ns == 10 * S
    onboard.decode(Endpoint("offboard", (1 << 41) + 1, KEY).encode(POSE, 0), 2 * S)
    assert onboard.clock_offset_ns is None


def test_a_flood_of_genuine_datagrams_is_limited() -> None:
    onboard, offboard = ends()
    datagrams = [offboard.encode(POSE, 0) for _ in range(5000)]
    taken = sum(onboard.decode(datagram, i * 200_000) is not None for i, datagram in enumerate(datagrams))
    assert RATE_BURST + 1900 < taken <= RATE_BURST + 2001
    assert onboard.statistics.rejected["rate"] == 5000 - taken
    assert onboard.statistics.lost == 0, "a refused datagram is not lost"


def test_a_forged_datagram_costs_no_more_than_its_mac(monkeypatch: pytest.MonkeyPatch) -> None:
    """The expensive steps, msgpack and the message itself, are not reached, and nothing is stored."""
    onboard, offboard = ends()
    forged = bytearray(offboard.encode(POSE, 0))
    forged[-1] ^= 1
    decoded: list[int] = []
    monkeypatch.setattr("protocol.endpoint.decode_body", lambda number, body: decoded.append(number))
    for _ in range(200):
        onboard.decode(bytes(forged), 0)
    assert (decoded, onboard.peer_session, onboard.statistics.received) == ([], None, 0)
    onboard.decode(offboard.encode(POSE, 0), 0)
    assert len(decoded) == 1


def test_an_older_session_is_challenged_and_accepted_when_it_answers() -> None:
    onboard, offboard = ends()
    offboard.decode(onboard.encode(TimeSyncRequest(0), 0), 0)
    recording = onboard.encode(TimeSyncRequest(1), 1)
    back = Endpoint("onboard", 77, KEY)
    assert offboard.challenge(5 * S) is None, "no older session was refused"
    assert offboard.decode(back.encode(TimeSyncRequest(5), 5), S // 2) is None
    assert offboard.challenge(S // 2) is None, "the current session is not silent yet"
    assert offboard.decode(back.encode(TimeSyncRequest(6), 6), 5 * S) is None
    challenge = offboard.challenge(5 * S)
    assert challenge == TimeSyncRequest(5 * S)
    offboard.encode(challenge, 5 * S)
    assert offboard.decode(back.encode(TimeSyncRequest(7), 7), 5 * S + MS) is None
    assert offboard.challenge(5 * S + MS) is None, "a recording cannot cause a challenge"
    assert offboard.decode(back.encode(TimeSyncReply(4 * S, 1, 1), 8), 5 * S + 2 * MS) is None, (
        "not the requested answer"
    )
    assert offboard.decode(back.encode(TimeSyncReply(5 * S, 1, 1), 9), 5 * S + 3 * MS) is not None
    assert offboard.peer_session == 77
    assert offboard.decode(recording, 9 * S) is None, "the session it replaced is retired"
    assert offboard.challenge(9 * S) is None, "and gets no challenge"
