"""Any bytes give a message or a counted rejection, and never an exception."""

import hashlib
from collections.abc import Callable
from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from protocol.codec import DOWN_TYPES, HEADER, UP_TYPES
from protocol.endpoint import Endpoint, Role
from protocol.errors import ProtocolError
from protocol.feature_codec import decode_feature_set, encode_feature_set
from protocol.feature_set import FeatureSet
from protocol.messages import REFUSALS, Message

KEY = b"k" * 32
Messages = tuple[tuple[Message, ...], tuple[Message, ...]]

trees = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats() | st.binary(max_size=100) | st.text(),
    lambda inner: st.lists(inner, max_size=13) | st.dictionaries(st.integers(0, 9), inner, max_size=3),
    max_leaves=20,
)
bodies = st.binary(max_size=1300) | trees.map(msgpack.packb) | st.lists(trees, max_size=12).map(msgpack.packb)


def seal(role: Role, header: tuple[int, ...], body: bytes) -> bytes:
    """A genuine datagram from the peer of `role`, with any content."""
    signed = HEADER.pack(*header) + body
    person = b"async-dmrac down" if role == "onboard" else b"async-dmrac up"
    return signed + hashlib.blake2b(signed, digest_size=16, key=KEY, person=person).digest()


def hear(endpoint: Endpoint, datagram: bytes, now_ns: int) -> None:
    """Decode, and check that the outcome was counted."""
    before = endpoint.statistics.rejected.total() + endpoint.statistics.duplicate
    message = endpoint.decode(datagram, now_ns)
    counted = endpoint.statistics.rejected.total() + endpoint.statistics.duplicate - before
    assert counted == (message is None)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_any_bytes(data: Any) -> None:
    role: Role = data.draw(st.sampled_from(["onboard", "offboard"]))
    endpoint = Endpoint(role, 1, KEY)
    types = sorted(DOWN_TYPES if role == "onboard" else UP_TYPES)
    u64 = st.integers(0, 2**64 - 1)
    header = st.tuples(st.just(1), st.sampled_from(types), st.just(1), u64, u64, u64)
    sealed = st.builds(seal, st.just(role), header, bodies)
    for datagram in data.draw(st.lists(st.binary(max_size=1300) | sealed, min_size=1, max_size=4)):
        hear(endpoint, datagram, data.draw(st.integers(0, 10**12)))


def fuzz(messages: Messages, cases: int, seed: int) -> None:
    """Datagrams of every type with bytes changed, cut, inserted; half of them signed afterwards."""
    rng = np.random.default_rng(seed)
    peers = {"onboard": ("offboard", messages[1]), "offboard": ("onboard", messages[0])}
    for role, (peer_role, sent) in peers.items():
        endpoint, peer = Endpoint(role, 1, KEY), Endpoint(peer_role, 2, KEY)  # type: ignore[arg-type]
        templates = [peer.encode(message, 10) for message in sent]
        for case in range(cases // 2):
            datagram = corrupt(templates[case % len(templates)], rng)
            if case % 4 < 3 and len(datagram) >= 44:
                header = list(HEADER.unpack_from(datagram))
                if case % 4 < 2:  # passes the header checks and reaches msgpack
                    header[:5] = 1, templates[case % len(templates)][1], 1, 2, case
                datagram = seal(role, tuple(header), datagram[HEADER.size : -16])  # type: ignore[arg-type]
            hear(endpoint, datagram, case * 1_000_000)


def corrupt(datagram: bytes, rng: np.random.Generator) -> bytes:
    corrupted = bytearray(datagram)
    for place in rng.random(size=rng.integers(1, 4)):
        at = int(place * len(corrupted))
        kind = rng.integers(0, 6)
        if kind < 3 and corrupted:
            corrupted[at] = rng.integers(0, 256)
        elif kind == 3:
            del corrupted[at : at + int(rng.integers(1, 9))]
        elif kind == 4:
            corrupted[at:at] = rng.bytes(int(rng.integers(1, 9)))
        else:
            del corrupted[at:]
    return bytes(corrupted)


def test_ten_thousand_corrupted_datagrams(all_messages: Messages) -> None:
    fuzz(all_messages, 10_000, seed=1)


@pytest.mark.full
@pytest.mark.parametrize("seed", range(10))
def test_a_million_corrupted_datagrams(all_messages: Messages, seed: int) -> None:
    fuzz(all_messages, 100_000, seed=100 + seed)


def fault_of(data: bytes) -> str:
    """The reason why these bytes are not a feature set; empty if they are one."""
    try:
        decode_feature_set(data)
    except ProtocolError as error:
        return error.reason
    return ""


def test_a_corrupted_feature_set(make_features: Callable[..., FeatureSet]) -> None:
    rng = np.random.default_rng(2)
    data = encode_feature_set(make_features(), "float16")
    head = data[:150]  # the structure; parameters follow
    for _ in range(2000):
        assert fault_of(corrupt(head, rng) + data[150:]) in REFUSALS


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(data=bodies)
def test_any_bytes_as_a_feature_set(data: bytes) -> None:
    assert fault_of(data) in REFUSALS
