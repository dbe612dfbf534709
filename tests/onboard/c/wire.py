"""Messages of both cores, for tests of codec, endpoint and link: random ones, and how C holds them."""

import struct
from collections.abc import Callable
from dataclasses import fields
from typing import Any

import msgpack
import numpy as np
from hypothesis import settings
from hypothesis import strategies as st

from protocol.codec import encode_body
from protocol.messages import (
    CHUNK_DATA_MAX_BYTES,
    MODES,
    REFUSALS,
    VERSION_MAX,
    FeatureChunk,
    Message,
    Pose,
    SampleBatch,
    Status,
    TimeSyncReply,
    TimeSyncRequest,
)
from protocol.signals import SIGNAL_COUNT
from protocol.statistics import REJECTIONS
from tests.onboard.c.parity import SANITIZED, SETTINGS, octets_of, view

MANY = settings(SETTINGS, max_examples=30 if SANITIZED else 200)
"""Examples are cheap here."""

MEMBERS = {FeatureChunk: "chunk", Pose: "pose", TimeSyncRequest: "request", TimeSyncReply: "reply"}
"""Of C's Message."""
REASON = {name: index for index, name in enumerate(REJECTIONS)}

edges = st.sampled_from([2**power + step for power in range(1, 63) for step in (-1, 0)])
counters = st.integers(0, 2**63 - 1) | st.integers(0, 300) | edges
versions = st.integers(0, VERSION_MAX) | st.integers(0, 300)
layouts = st.binary(min_size=8, max_size=8)
floats = st.floats(-1e6, 1e6, width=32)


def arrays(*shape: int) -> st.SearchStrategy[np.ndarray[Any, Any]]:
    """float32, cheap to draw: a seed and a few chosen numbers."""

    def make(seed: int, first: list[float]) -> np.ndarray[Any, Any]:
        array = np.random.default_rng(seed).normal(scale=10.0, size=shape).astype(np.float32)
        array.flat[: len(first)] = first
        return array

    return st.builds(make, st.integers(0, 2**32), st.lists(floats, max_size=3))


def _pose(time_ns: int, position: np.ndarray[Any, Any], turn: np.ndarray[Any, Any], size: float) -> Pose:
    return Pose(time_ns, position, (turn / np.linalg.norm(turn) * size).astype(np.float32))


def _batch(n: int) -> st.SearchStrategy[SampleBatch]:
    shapes = (arrays(n, SIGNAL_COUNT), arrays(n, 2, 3), arrays(n, 2, 3))
    return st.builds(SampleBatch, counters, counters, st.integers(1, 10**9), versions, *shapes)


def _data(size: int) -> bytes:
    return (bytes(range(256)) * 5)[:size]


batches = st.integers(1, 8).flatmap(_batch)
statuses = st.builds(
    Status,
    *(
        st.integers(0, MODES - 1),
        versions,
        versions,
        st.binary(max_size=8),
        versions,
        st.integers(0, len(REFUSALS) - 1),
        counters,
        counters,
    ),
    *(st.integers(-1, 2**32 - 1), counters, counters, counters),
)
requests = st.builds(TimeSyncRequest, counters, layouts)
replies = st.builds(
    lambda origin, pair, layout: TimeSyncReply(origin, *sorted(pair), layout),
    *(counters, st.tuples(counters, counters), layouts),
)
data_sizes = st.integers(1, CHUNK_DATA_MAX_BYTES) | st.sampled_from([1, 255, 256, 1100])
chunks = st.integers(1, 64).flatmap(
    lambda count: st.builds(
        FeatureChunk,
        *(st.integers(1, VERSION_MAX), st.integers(0, count - 1), st.just(count)),
        *(st.binary(min_size=16, max_size=16), data_sizes.map(_data)),
    )
)
poses = st.builds(_pose, counters, arrays(3), arrays(4).filter(lambda q: bool(q.any())), st.floats(0.9992, 1.0008))
up = st.one_of(batches, statuses, requests, replies)
down = st.one_of(chunks, poses, requests, replies)


def plain(message: Any) -> Any:
    """A message as a tuple that can be compared: arrays as bytes."""
    values = (getattr(message, field.name) for field in fields(message))
    return (type(message), *(one.tobytes() if isinstance(one, np.ndarray) else one for one in values))


def from_c(core: Any, message: Any) -> Any:
    """The member of C's Message that counts, as `plain` gives it."""
    kind = {getattr(core, f"MESSAGE_{name}"): one for name, one in TYPE_NAMES.items()}[message.type]
    return (kind, *_VALUES[kind](getattr(message, MEMBERS[kind])))


TYPE_NAMES = {
    "SAMPLE_BATCH": SampleBatch,
    "STATUS": Status,
    "TIME_SYNC_REQUEST": TimeSyncRequest,
    "FEATURE_CHUNK": FeatureChunk,
    "POSE": Pose,
    "TIME_SYNC_REPLY": TimeSyncReply,
}
"""Of C's MessageType."""


def chunk_of(chunk: Any) -> tuple[Any, ...]:
    """The values of C's FeatureChunk in numpy's order."""
    return chunk.version, chunk.index, chunk.count, octets_of(chunk.digest), octets_of(chunk.data)[: chunk.size]


def _float32(values: Any) -> bytes:
    return np.asarray(values, dtype=np.float32).tobytes()


_VALUES: dict[Any, Callable[[Any], tuple[Any, ...]]] = {
    FeatureChunk: chunk_of,
    Pose: lambda m: (m.time_ns, _float32(m.pose.position), _float32(m.pose.quaternion)),
    TimeSyncRequest: lambda m: (m.origin_ns, octets_of(m.layout)),
    TimeSyncReply: lambda m: (m.origin_ns, m.receive_ns, m.transmit_ns, octets_of(m.layout)),
}


def to_c(core: Any, message: Message) -> Any:
    """A message that onboard sends, as C has it."""
    target = getattr(core, type(message).__name__)()
    for field in fields(message):
        value = getattr(message, field.name)
        if isinstance(value, np.ndarray):
            view(getattr(target, field.name))[: value.size] = value.reshape(-1)
            target.count = value.shape[0]
        elif isinstance(value, bytes):
            view(getattr(target, field.name))[: len(value)] = list(value)
            if field.name == "received_chunks":
                target.received_chunks_size = len(value)
        else:
            setattr(target, field.name, value)
    return target


# --- bodies that may be wrong ---


def long_forms(message: Message, wide: list[int]) -> bytes:
    """The body of a message with every field in a form that is longer than needed, `wide` saying which."""
    values = msgpack.unpackb(encode_body(message))
    count = len(values)
    body = (bytes([0x90 | count]), struct.pack(">BH", 0xDC, count), struct.pack(">BI", 0xDD, count))[wide[0] % 3]
    for place, value in enumerate(values):
        form = wide[(place + 1) % len(wide)]
        if isinstance(value, bytes):
            head = struct.pack(">BI", 0xC6, len(value)) if form % 2 else struct.pack(">BH", 0xC5, len(value))
            body += head + value
        else:
            signed = form % 2 or value < 0
            body += struct.pack(">Bq", 0xD3, value) if signed else struct.pack(">BQ", 0xCF, value)
    return body


special = st.sampled_from([-1, 0, 1, 64, 65, 2**32, 2**63 - 1, 2**63, 2**64 - 1])
wild_numbers = st.integers(-(2**63), 2**64 - 1) | special
wild_bytes = st.binary(max_size=40) | st.sampled_from([bytes(size) for size in (0, 8, 12, 16, 1100, 1101, 1150)])
trees = st.recursive(
    st.none() | st.booleans() | wild_numbers | st.floats() | wild_bytes | st.text(max_size=3),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.integers(0, 9), inner, max_size=2),
    max_leaves=5,
)
KINDS = {"request": "ib", "reply": "iiib", "chunk": "iiibb", "pose": "ibb"}
wild_bodies = st.one_of(
    st.binary(max_size=80),
    trees.map(msgpack.packb),
    st.lists(trees, max_size=13).map(msgpack.packb),
    *(
        st.tuples(*(wild_numbers if kind == "i" else wild_bytes for kind in kinds)).map(msgpack.packb)
        for kinds in KINDS.values()
    ),
)


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """Bytes changed, cut, put in or left out, a few times."""
    changed = bytearray(data)
    for place in rng.random(size=rng.integers(1, 4)):
        at, kind = int(place * len(changed)), rng.integers(0, 7)
        if kind < 3 and changed:
            changed[at] = rng.integers(0, 256)
        elif kind == 3 and changed:
            changed[at] ^= 1 << int(rng.integers(0, 8))
        elif kind == 4:
            del changed[at : at + int(rng.integers(1, 9))]
        elif kind == 5:
            changed[at:at] = rng.bytes(int(rng.integers(1, 9)))
        else:
            del changed[at:]
    return bytes(changed)
