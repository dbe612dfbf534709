"""Random sequences of datagrams through both cores' links: the same results, reasons and states after each.

A sequence has restarts of the peer (also with its clock set back), replays, losses, silences, datagrams late and out of
order, bytes changed with and without the right MAC, and everything that onboard sends by itself.
"""

from collections import Counter
from typing import Any, Final

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.c.library import Core
from protocol.codec import DOWN_TYPES, HEADER, encode_body
from protocol.endpoint import Endpoint
from protocol.feature_config import feature_digest
from protocol.messages import VERSION_MAX, FeatureChunk, Message, Pose, SampleBatch, TimeSyncReply, TimeSyncRequest
from protocol.statistics import REJECTIONS
from tests.onboard.c import wire
from tests.onboard.c.link_pair import KEY, Both, onboard_config, resealed, sealed
from tests.onboard.c.parity import SANITIZED

MS, S = 1_000_000, 1_000_000_000
TYPES: Final = sorted(DOWN_TYPES)


class World:
    """A peer, a radio and our two links."""

    def __init__(self, core: Core, seed: int, key: bytes | None = KEY) -> None:
        config = onboard_config().model_copy(update={"status_period_s": 0.125})  # the same number in float
        self.rng, self.both, self.key = np.random.default_rng(seed), Both(core, config, key), key
        self.now_ns, self.peer_clock_ns, self.newest_session = 100 * S, 10**13, 1 << 30
        self.sent: list[bytes] = []
        self.waiting: list[bytes] = []
        self.request: tuple[int, int] | None = None
        self.seen: Counter[str] = Counter()
        self.start_peer(self.newest_session)

    def start_peer(self, session: int) -> None:
        own = feature_digest(onboard_config().features)
        layout = own if self.rng.random() < 0.9 else self.rng.bytes(8)
        self.peer = Endpoint("offboard", session, self.key, self.both.config.vehicle_id, layout)
        self.newest_session = max(self.newest_session, session)

    # --- what happens in one step ---

    def step(self) -> None:
        """Time passes; each side may send; the radio delivers or spoils."""
        rng = self.rng
        self.now_ns += int(rng.choice([1, 5, 5, 20, 1200], p=[0.3, 0.35, 0.3, 0.04, 0.01]) * MS)
        if rng.random() < 0.007:
            self.restart()
        if rng.random() < 0.4:
            self.waiting.append(self.peer.encode(self.message(), self.now_ns + self.peer_clock_ns))
        self.onboard_sends()
        chance = rng.random()
        if chance < 0.05 and self.sent:
            self.deliver(self.sent[int(rng.integers(len(self.sent)))])  # a replay
        elif chance < 0.2:
            self.deliver(self.spoilt())
        while self.waiting and rng.random() < 0.6:
            index = 0 if rng.random() < 0.8 else int(rng.integers(len(self.waiting)))
            datagram = self.waiting.pop(index)
            self.sent.append(datagram)
            if rng.random() < 0.85:
                self.deliver(datagram)

    def restart(self) -> None:
        """A newer session, one of a wall clock that was set back, or an earlier one."""
        rng = self.rng
        session = self.newest_session + int(rng.integers(1, 5))
        if rng.random() < 0.3:
            session = max(self.newest_session - int(rng.integers(0, 30)), 0)
            self.now_ns += int(rng.integers(0, 3)) * S
        if rng.random() < 0.3:
            self.peer_clock_ns += int(rng.integers(-S, S))
        self.start_peer(session)

    def message(self) -> Message:
        rng, peer_ns = self.rng, self.now_ns + self.peer_clock_ns
        kind = rng.random()
        if self.request and kind < 0.4:
            (origin_ns, came_ns), self.request = self.request, None
            return TimeSyncReply(origin_ns, came_ns, max(came_ns, peer_ns))
        if 0.4 < kind < 0.43:
            return TimeSyncReply(*(int(one) for one in np.sort(rng.integers(0, 2**63 - 1, 3))))
        if kind < 0.5:
            return TimeSyncRequest(peer_ns)
        if kind < 0.7:
            count = int(rng.integers(1, 65))
            size = int(rng.integers(1, 1101))
            return FeatureChunk(
                int(rng.integers(1, VERSION_MAX)), int(rng.integers(count)), count, rng.bytes(16), rng.bytes(size)
            )
        q = rng.normal(size=4)
        return Pose(peer_ns, rng.normal(size=3).astype(np.float32), (q / np.linalg.norm(q)).astype(np.float32))

    def onboard_sends(self) -> None:
        rng, both = self.rng, self.both
        if rng.random() < 0.5:
            for datagram in both.call("time_sync", self.now_ns):
                if datagram[1] == 3 and rng.random() < 0.8:
                    self.request = HEADER.unpack_from(datagram)[5], self.now_ns + self.peer_clock_ns
        if rng.random() < 0.1:
            both.status(self.now_ns, rng)
        if rng.random() < 0.1:
            n = int(rng.integers(1, 9))
            arrays = (rng.normal(size=shape).astype(np.float32) for shape in ((n, 21), (n, 2, 3), (n, 2, 3)))
            batch = SampleBatch(int(rng.integers(2**40)), self.now_ns, 20 * MS, int(rng.integers(VERSION_MAX)), *arrays)
            both.call("encode", batch, self.now_ns)
        if rng.random() < 0.3:
            both.loss_share(self.now_ns)
            both.call("clock_record", self.now_ns)
        if rng.random() < 0.1:
            both.call("take_events")

    def spoilt(self) -> bytes:
        """A datagram that the peer would not send."""
        rng = self.rng
        genuine = self.peer.encode(self.message(), self.now_ns + self.peer_clock_ns)
        match int(rng.integers(0, 8)):
            case 0:
                return rng.bytes(int(rng.integers(0, 1300)))
            case 1:
                return wire.mutated(genuine, rng)
            case 2:  # a right MAC over a body with changed bytes
                return resealed(self.key, genuine, wire.mutated(genuine[HEADER.size : -16], rng))
            case 3:
                return resealed(self.key, genuine, number=int(rng.choice([*TYPES, 0, 1, 2, 64, 255])))
            case 4:
                return resealed(self.key, genuine, **self.other_header())
            case 5:
                return sealed(b"another key of some length", HEADER.unpack_from(genuine), genuine[HEADER.size : -16])
            case 6:
                return resealed(self.key, genuine, self.wrong_values(genuine[1]))
            case _:
                return genuine[: int(rng.integers(len(genuine)))]

    def wrong_values(self, number: int) -> bytes:
        """A body of the right types, with values of all sizes."""
        rng = self.rng
        numbers = [-1, 0, 1, 2, 64, 65, 2**32 - 1, 2**32, 2**63 - 1, 2**63]
        sizes = [0, 8, 12, 16, 16, 1100]
        values = [
            numbers[int(rng.integers(10))] if kind == "i" else rng.bytes(sizes[int(rng.integers(6))])
            for kind in {3: "ib", 65: "iiibb", 66: "ibb", 67: "iiib"}[number]
        ]
        body: bytes = msgpack.packb(values)
        return body

    def other_header(self) -> dict[str, int]:
        """One field of the header with another value."""
        rng, near = self.rng, int(self.rng.integers(-300, 300))
        newest = self.peer._sequence
        return [
            {"version": int(rng.integers(256))},
            {"vehicle_id": int(rng.integers(2**16))},
            {"session": max(self.newest_session - int(rng.integers(40)), 0)},
            {"sequence": max(newest + near, 0)},
            {
                "sequence": newest
                + int(rng.integers(2**32 + 10**6) if rng.random() < 0.1 else rng.integers(2**32, 2**34))
            },
            {"sent_ns": int(rng.integers(0, 2**63 if rng.random() < 0.5 else 1000))},
        ][int(rng.integers(6))]

    def deliver(self, datagram: bytes) -> None:
        """To both links, a little before now."""
        before = self.both.rejected
        received = self.both.receive(datagram, self.now_ns - int(self.rng.integers(0, 4 * MS)))
        self.seen.update(type(one).__name__ for one in received)
        for reason, count in self.both.rejected.items():
            self.seen[reason] += count - before.get(reason, 0)


def wander(core: Core, seed: int, steps: int, key: bytes | None = KEY) -> Counter[str]:
    """What happened, by kind of result and by reason."""
    world = World(core, seed, key)
    for _ in range(steps):
        world.step()
    world.seen["duplicate"] = world.both.theirs.statistics.duplicate
    world.seen["sessions"] = world.both.theirs.statistics.sessions
    return world.seen


@pytest.mark.parametrize("seed", range(2 if SANITIZED else 6))
def test_random_sequences(core: Core, seed: int) -> None:
    wander(core, seed, 300 if SANITIZED else 1000, None if seed == 1 else KEY)


def test_random_sequences_in_the_float_core(core32: Core) -> None:
    wander(core32, 50, 1000)


def test_random_sequences_meet_every_reason(core: Core) -> None:
    seen: Counter[str] = Counter()
    for seed in range(100, 104):
        seen += wander(core, seed, 1500)
    reasons = set(REJECTIONS) - {"", "rate", "before_start"}  # test_link.py
    assert not reasons - set(seen)
    assert seen["sessions"] > 20
    assert seen["str"] > 10, "restarts"
    assert seen["tuple"] > 250, "poses and chunks"
    assert min(seen[reason] for reason in reasons) >= 5


@pytest.mark.full
@pytest.mark.parametrize("seed", range(1000, 1020))
def test_long_random_sequences(core: Core, seed: int) -> None:
    wander(core, seed, 20_000)


@wire.MANY
@given(
    steps=st.lists(
        st.tuples(
            st.sampled_from(TYPES),
            st.sampled_from([5, 6, 7, 4]),
            st.integers(0, 600),
            st.integers(0, 2**63 - 1) | st.integers(0, 10 * S),
            st.integers(0, 2 * S),
            wire.wild_bodies | wire.down.map(encode_body),
        ),
        min_size=1,
        max_size=12,
    )
)
def test_any_genuine_datagrams(core: Core, steps: list[Any]) -> None:
    """Right MACs around anything, among our own requests, whose answers are drawn rarely but with every value."""
    both, now_ns = Both(core), S
    for number, session, sequence, sent_ns, pause_ns, body in steps:
        now_ns += pause_ns
        both.call("time_sync", now_ns)
        both.receive(sealed(KEY, (2, number, both.config.vehicle_id, session, sequence, sent_ns), body), now_ns)
        if number == 67:  # the same, as the answer to our newest request
            answer = TimeSyncReply(both.theirs._asked_ns, sent_ns, sent_ns + min(pause_ns, 2**63 - 1 - sent_ns))
            header = (2, number, both.config.vehicle_id, session, sequence + 1, sent_ns)
            both.receive(sealed(KEY, header, encode_body(answer)), now_ns)
        both.loss_share(now_ns)
