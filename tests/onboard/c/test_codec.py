"""The bodies of messages: what the C core writes is numpy's to the byte, and what it reads means the same."""

import ctypes
import itertools
import math
import struct
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from onboard.c.library import Core
from protocol.codec import DOWN_TYPES, TYPE_NUMBERS, decode_body, encode_body
from protocol.errors import ProtocolError
from protocol.messages import FeatureChunk, Message, Pose, SampleBatch, Status, TimeSyncReply, TimeSyncRequest
from tests.onboard.c import wire
from tests.onboard.c.parity import SETTINGS, octets
from tests.onboard.c.wire import REASON

BODY_MAX = 1156
ENCODERS: dict[type[Any], str] = {
    SampleBatch: "sample_batch",
    Status: "status",
    TimeSyncRequest: "time_sync_request",
    TimeSyncReply: "time_sync_reply",
}


def encoded(core: Core, kind: type[Any], message: Any, room: int = BODY_MAX) -> bytes | None:
    """What C writes of one of its own messages; None if it refuses."""
    space = (ctypes.c_uint8 * room)()
    writer = core.MsgpackWriter(ctypes.cast(space, ctypes.POINTER(ctypes.c_uint8)), room, 0, False)
    done = getattr(core, f"encode_{ENCODERS[kind]}")(message, writer)
    return bytes(space)[: writer.size] if done else None


def decoded(core: Core, number: int, body: bytes) -> tuple[int, Any]:
    """Reason and message of C; the message is None unless the reason is 0."""
    message = core.Message()
    reason = core.decode_body(number, octets(body), len(body), message)
    return reason, None if reason else wire.from_c(core, message)


def expected(number: int, body: bytes) -> tuple[int, Any]:
    try:
        return 0, wire.plain(decode_body(number, body))
    except ProtocolError as error:
        return REASON[error.reason], None


def test_the_numbers_of_the_messages(core: Core) -> None:
    assert set(wire.TYPE_NAMES.values()) == set(TYPE_NUMBERS)
    for name, kind in wire.TYPE_NAMES.items():
        assert getattr(core, f"MESSAGE_{name}") == TYPE_NUMBERS[kind]
    assert {number for number in range(-300, 300) if core.is_sent_down(number)} == DOWN_TYPES


@wire.MANY
@given(message=wire.up)
def test_what_onboard_sends(core: Core, message: Message) -> None:
    body = encode_body(message)
    assert encoded(core, type(message), wire.to_c(core, message)) == body
    assert encoded(core, type(message), wire.to_c(core, message), len(body)) == body
    for room in (0, 1, len(body) // 2, len(body) - 1):
        assert encoded(core, type(message), wire.to_c(core, message), room) is None


EXTREME = (-(2**63), -2, -1, 0, 1, 10, 11, 16, 17, 10**6, 10**6 + 1, 10**9, 10**9 + 1, 2**32 - 1, 2**32, 2**63 - 1)


@pytest.mark.parametrize("kind", [SampleBatch, Status, TimeSyncReply, TimeSyncRequest])
def test_values_that_are_not_allowed_are_not_sent(core: Core, kind: type[Any]) -> None:
    """Every number of a message in turn at and beyond its limits: refused exactly when numpy's core refuses."""
    start: Any = {
        SampleBatch: SampleBatch(
            1, 2, 3, 4, *(np.zeros(shape, np.float32) for shape in ((2, 21), (2, 2, 3), (2, 2, 3)))
        ),
        Status: Status(1, 2, 3, b"\x05", 4, 5, 6, 7, 8, 9, 10, 11),
        TimeSyncReply: TimeSyncReply(1, 16, 17),
        TimeSyncRequest: TimeSyncRequest(1),
    }[kind]
    refused = 0
    for name in (name for name in start.__slots__ if isinstance(getattr(start, name), int)):
        for value in EXTREME:
            ours = wire.to_c(core, start)
            setattr(ours, name, value)
            try:
                body = encode_body(replace(start, **{name: value}))
            except ValueError:
                body, refused = None, refused + 1
            assert encoded(core, kind, ours) == body, (name, value)
    assert refused >= 2


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e6, -1e6, 1000000.0625, -1000000.0625, 1e-45])
def test_samples_that_are_not_numbers_are_not_sent(core: Core, value: float) -> None:
    shapes = ((3, 21), (3, 2, 3), (3, 2, 3))
    for which in range(3):
        for place in (0, -1):
            arrays = [np.zeros(shape, np.float32) for shape in shapes]
            ours = wire.to_c(core, SampleBatch(1, 2, 3, 4, *arrays))
            name, array = ("signals", "delivered", "adaptive")[which], arrays[which]
            array.flat[place] = value
            getattr(ours, name)[place % array.size] = value
            try:
                body = encode_body(SampleBatch(1, 2, 3, 4, *arrays))
            except ValueError:
                body = None
            assert encoded(core, SampleBatch, ours) == body
            assert (body is None) == (not abs(value) <= 1e6)


def test_counts_that_do_not_fit_their_arrays_are_not_sent(core: Core) -> None:
    for count in (-1, 0, 9, 2**31 - 1):
        batch = wire.to_c(
            core, SampleBatch(1, 2, 3, 4, *(np.zeros(s, np.float32) for s in ((1, 21), (1, 2, 3), (1, 2, 3))))
        )
        batch.count = count
        assert encoded(core, SampleBatch, batch) is None
    for size in (-1, 9, 2**31 - 1):
        status = wire.to_c(core, Status(1, 2, 3, b"", 4, 5, 6, 7, 8, 9, 10, 11))
        status.received_chunks_size = size
        assert encoded(core, Status, status) is None


@wire.MANY
@given(message=wire.down, wide=st.lists(st.integers(0, 5), min_size=1, max_size=4))
def test_what_offboard_sends(core: Core, core32: Core, message: Message, wide: list[int]) -> None:
    for body in (encode_body(message), wire.long_forms(message, wide)):
        for one in (core, core32):
            assert decoded(one, TYPE_NUMBERS[type(message)], body) == (0, wire.plain(message))


@SETTINGS
@given(message=wire.down)
def test_a_body_of_another_type_or_length(core: Core, message: Message) -> None:
    body = encode_body(message)
    for number in DOWN_TYPES:
        for one in (body, body + b"\x00", body[:-1], body[: len(body) // 2], body[:1], b""):
            assert decoded(core, number, one) == expected(number, one)


@wire.MANY
@given(body=wire.wild_bodies, number=st.sampled_from(sorted(DOWN_TYPES)))
@example(body=b"\x91\xc1", number=66)
def test_any_bodies(core: Core, body: bytes, number: int) -> None:
    assert decoded(core, number, body) == expected(number, body)


MESSAGES = (
    FeatureChunk(13, 7, 8, bytes(range(16)), b"\xff" * 70),
    Pose(9, np.array([1.0, -2.0, -1.5], np.float32), np.array([0.6, 0.0, 0.8, 0.0], np.float32)),
    TimeSyncReply(5_000_000_000, 8, 9),
    TimeSyncRequest(5_000_000_000),
)


def compare_mutated(core: Core, cases: int, seed: int) -> None:
    rng, bodies = np.random.default_rng(seed), [(TYPE_NUMBERS[type(one)], encode_body(one)) for one in MESSAGES]
    good = 0
    for case in range(cases):
        number, body = bodies[case % len(bodies)]
        changed = wire.mutated(body, rng)
        ours = decoded(core, number, changed)
        assert ours == expected(number, changed), (number, changed.hex())
        good += ours[0] == 0
    assert cases / 50 < good < cases / 2


def test_mutated_bodies(core: Core) -> None:
    compare_mutated(core, 4000, 1)


@pytest.mark.full
def test_many_mutated_bodies(core: Core) -> None:
    compare_mutated(core, 400_000, 2)


def test_every_first_byte_of_a_field(core: Core) -> None:
    tails = (b"", bytes(8), b"\xff" * 8, b"\x00\x08" + b"a" * 8, b"\x08" + b"a" * 8, b"\x80" + bytes(7))
    for first, tail in itertools.product(range(256), tails):
        field = bytes([first]) + tail
        for body in (field, b"\x92" + field, b"\x92\x05" + field):
            for whole in (body, body + b"\xc4\x08" + bytes(8)):
                assert decoded(core, 3, whole) == expected(3, whole), whole.hex()


@pytest.mark.parametrize("number", [0, 1, 2, 4, 64, 68, 255, -1])
def test_types_that_offboard_does_not_send(core: Core, number: int) -> None:
    assert decoded(core, number, b"\x90") == (REASON["type"], None)


@pytest.mark.parametrize("length", [0.9985, 0.99899, 0.99901, 1.0, 1.00099, 1.00101, 1.0015, 0.0, math.inf, math.nan])
def test_the_length_of_a_quaternion(core: Core, core32: Core, length: float) -> None:
    for direction in ((1.0, 0.0, 0.0, 0.0), (0.5, -0.5, 0.5, 0.5), (0.0, 0.6, 0.0, 0.8)):
        body = b"\x93\x05\xc4\x0c" + bytes(12) + b"\xc4\x10" + struct.pack("<4f", *(length * one for one in direction))
        for one in (core, core32):
            assert decoded(one, 66, body) == expected(66, body)
