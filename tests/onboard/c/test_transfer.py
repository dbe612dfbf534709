"""From chunks to a feature set: the C core against protocol.feature_codec and protocol.transfer."""

import dataclasses
from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.c.feature_arrays import put_chunk
from onboard.c.library import Core
from protocol.errors import ProtocolError
from protocol.feature_codec import decode_feature_set, encode_feature_set
from protocol.feature_set import FeatureSet
from protocol.messages import CHUNK_COUNT_MAX, REFUSALS, FeatureChunk
from protocol.signals import SIGNAL_NAMES
from protocol.transfer import FeatureReceiver, digest_of, split
from tests.onboard.c.channels import c_channel, channel
from tests.onboard.c.parity import SETTINGS, octets, octets_of, view

SEEDS = st.integers(0, 2**31)


def feature_set(seed: int, version: int = 7, covers: tuple[bool, bool] = (True, True)) -> FeatureSet:
    """Random features, as small as a network can be or larger."""
    rng = np.random.default_rng(seed)
    widths = [(1,), (4, 3), (32, 32, 19)][seed % 3]
    position, attitude = (channel(int(rng.integers(2**31)), widths) if one else None for one in covers)
    return FeatureSet(version, 3, 100, position, attitude)


def encoded(seed: int, float_name: Any = "float16", **values: Any) -> bytes:
    return encode_feature_set(feature_set(seed, **values), float_name)


def expected(data: bytes, version: int) -> tuple[str, FeatureSet | None]:
    """numpy's answer: the refusal, or the features."""
    try:
        features = decode_feature_set(data)
    except ProtocolError as error:
        return error.reason, None
    return ("", features) if features.version == version else ("undecodable", None)


def same_features(core: Core, ours: Any, theirs: FeatureSet) -> None:
    """The same numbers to the bit, of C's number type."""
    samples = min(theirs.samples, 2**63 - 1)  # of more there is only the text of an event
    assert (ours.version, ours.parent, ours.samples) == (theirs.version, theirs.parent, samples)
    assert list(ours.covers) == [one is not None for one in theirs.by_channel]
    for own, other in zip(ours.channels, theirs.by_channel, strict=True):
        if other is not None:
            wanted, m, k = c_channel(core, other), len(other.inputs), other.feature_count
            sizes = {"index": m, "offset": m, "scale": m}
            assert own.selection.count == m
            for name, size in sizes.items():
                np.testing.assert_array_equal(
                    view(getattr(own.selection, name))[:size], view(getattr(wanted.selection, name))[:size]
                )
            layers = len(other.weights)
            assert list(own.network.width[:layers]) == list(wanted.network.width[:layers])
            count = sum(W.size + b.size for W, b in zip(other.weights, other.biases, strict=True))
            np.testing.assert_array_equal(view(own.network.parameters)[:count], view(wanted.network.parameters)[:count])
            np.testing.assert_array_equal(view(own.last_layer)[: 3 * k], view(wanted.last_layer)[: 3 * k])


def decode(core: Core, data: bytes, version: int = 7) -> str:
    """C's refusal; what it has decoded is compared with numpy's."""
    ours = core.FeatureSet(samples=-5)
    refusal = REFUSALS[core.decode_feature_set(octets(data), len(data), version, ours)]
    wanted, theirs = expected(data, version)
    assert refusal == wanted
    if theirs is None:
        assert (ours.samples, ours.version, list(ours.covers)) == (-5, 0, [False, False])
    else:
        same_features(core, ours, theirs)
    return refusal


@SETTINGS
@given(seed=SEEDS, float_name=st.sampled_from(["float16", "float32"]), covers=st.sampled_from([(1, 1), (1, 0), (0, 1)]))
def test_good_features_are_decoded_to_the_bit(
    core: Core, core32: Core, seed: int, float_name: Any, covers: Any
) -> None:
    data = encoded(seed, float_name, covers=covers)
    for one in (core, core32):
        assert decode(one, data) == ""


def test_every_half_precision_number(core: Core) -> None:
    """All finite numbers of 16 bits, in networks of the largest width that has as many parameters."""
    bits = np.arange(2**16, dtype=np.uint16)
    numbers = bits.view(np.float16)[np.isfinite(bits.view(np.float16))].astype(float)
    source = channel(1, (128, 128))
    flat, weights = iter(np.resize(numbers, 128 * 128 * 5)), []
    for _ in range(4):
        W = np.array([next(flat) for _ in range(128 * 128)]).reshape(128, 128)
        big = dataclasses.replace(source, weights=(source.weights[0], W), last_layer=np.zeros((129, 3)))
        weights.append(W)
        assert decode(core, encode_feature_set(FeatureSet(7, 0, 1, big, None), "float16")) == ""
    assert np.concatenate([W.reshape(-1) for W in weights]).size >= numbers.size


@SETTINGS
@given(seed=SEEDS, cut=st.booleans())
def test_changed_bytes_get_the_same_answer(core: Core, seed: int, cut: bool) -> None:
    rng, data = np.random.default_rng(seed), bytearray(encoded(3 * (seed // 3) + seed % 2))
    for _ in range(40):
        changed = bytearray(data)
        for at in rng.integers(0, min(len(data), 400), int(rng.integers(1, 4))):
            changed[at] = rng.choice([rng.integers(256), 0x80, 0x90, 0xC0, 0xC1, 0xC7, 0xD9, 0xDD, 0xFF])
        if cut:
            changed = changed[: int(rng.integers(0, len(changed)))]
        decode(core, bytes(changed))


TREES = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats() | st.binary(max_size=40) | st.text(),
    lambda inner: st.lists(inner, max_size=23) | st.dictionaries(st.integers(0, 9), inner, max_size=1),
    max_leaves=20,
)


@SETTINGS
@given(data=st.binary(max_size=300) | TREES.map(msgpack.packb))
def test_any_bytes_get_the_same_answer(core: Core, data: bytes) -> None:
    assert decode(core, data) != ""


NAN16 = np.array([np.nan], "<f2").tobytes()
ODD: list[Any] = [None, True, -1, 0, 1, 2, 4, 128, 129, 2**32, 2**63, 2**64 - 1, 1.5, b"", b"1234", "yaw", "no", [], {}]
ODD += [["yaw", "roll"], ["yaw", "yaw"], ["roll"] * 22, [3], [3, 3], [0], [b""], NAN16, [None], "ä", "x" * 40]
ODD += [msgpack.ExtType(5, b""), msgpack.ExtType(5, b"1"), np.array([1.0, -1.0], "<f4").tobytes()]
ODD += [np.array([1.0, np.inf], "<f4").tobytes(), np.array([0.0, 1.0], "<f4").tobytes(), [[3]], [SIGNAL_NAMES[0], "q"]]
PLACES = [(0,), (1,), (2,), (3,), (4,), (5,), (6,), *((5, i) for i in range(5)), *((6, i) for i in range(5))]
PLACES += [(5, 0, 0), (5, 0, 1), (5, 3, 0)]


def changed(fields: Any, place: tuple[int, ...], value: Any) -> Any:
    """The tree with another value at a place."""
    if not place:
        return value
    copy = list(fields)
    copy[place[0]] = changed(copy[place[0]], place[1:], value)
    return copy


def small(version: int = 7) -> list[Any]:
    """Fields of the smallest feature set with two inputs."""
    vector = np.array([1.0, 2.0], "<f4").tobytes()
    one = [["yaw", "roll"], vector, vector, [1], np.arange(9.0).astype("<f2").tobytes()]
    return [1, 2, version, 0, 5, one, one]


def test_every_odd_value_in_every_place_gets_the_same_answer(core: Core) -> None:
    seen = {decode(core, msgpack.packb(small()))}
    for place in PLACES:
        for value in ODD:
            seen.add(decode(core, msgpack.packb(changed(small(), place, value))))
    bad = [changed(small(), (5, 4), np.full(9, np.nan, "<f2").tobytes()), [*small(), 1], small()[:-1], small(8)]
    seen |= {decode(core, msgpack.packb(one)) for one in bad}
    assert seen == {"", "undecodable", "inputs", "not_finite"}


NO_TEXT = [b"\xff", b"\xc0\x80", b"\xe0\x80\x80", b"\xed\xa0\x80", b"\xf4\x90\x80\x80", b"\xc3"]
TEXT = [b"\xc3\xa4", b"\xe2\x82\xac", b"\xf0\x9f\x9a\x81", b"\xed\x9f\xbf", b"\xf4\x8f\xbf\xbf"]


@pytest.mark.parametrize(
    ("name", "refusal"), [*((one, "undecodable") for one in NO_TEXT), *((one, "inputs") for one in TEXT)]
)
def test_a_name_must_be_utf_8(core: Core, name: bytes, refusal: str) -> None:
    data = msgpack.packb(changed(small(), (5, 0, 1), "roll"))
    assert decode(core, data.replace(b"\xa4roll", bytes([0xA0 + len(name)]) + name, 1)) == refusal


@pytest.mark.parametrize("code", [5, 255])
def test_an_empty_extension_is_a_value_of_another_kind(core: Core, code: int) -> None:
    data = msgpack.packb(changed(small(), (5, 0, 1), 1.5))
    decode(core, data.replace(msgpack.packb(1.5), bytes([0xC7, 0, code]), 1))
    decode(core, data.replace(msgpack.packb(1.5), bytes([0xC8, 0, 0, code]), 1))
    decode(core, data.replace(msgpack.packb(1.5), bytes([0xD4, code, 0]), 1))
    decode(core, data.replace(msgpack.packb(1.5), bytes([0xDF, 0, 0, 0, 0]), 1))


@pytest.mark.parametrize("place", [0, 3])
@pytest.mark.parametrize("depth", [1, 400, 1000, 60_000])
def test_lists_within_lists(core: Core, place: int, depth: int) -> None:
    """The deepest ones are too deep for msgpack in Python, whatever they stand for."""
    channel = [msgpack.packb(one) for one in small()[5]]
    channel[place] = b"\x91" * depth + b"\xc0"
    data = b"\x97" + b"".join(map(msgpack.packb, small()[:5])) + b"\x95" + b"".join(channel) + b"\xc0"
    if depth <= 1000:
        decode(core, data)
    else:
        refusal = core.decode_feature_set(octets(data), len(data), 7, core.FeatureSet())
        assert REFUSALS[refusal] == ("inputs" if place == 0 else "undecodable")
        assert expected(data, 7)[0] == "undecodable"


# --- chunks ---


def c_chunk(core: Core, chunk: FeatureChunk) -> Any:
    """The chunk in C."""
    target = core.FeatureChunk()
    put_chunk(target, chunk)
    return target


class Both:
    """The two receivers, side by side."""

    def __init__(self, core: Core) -> None:
        self.core, self.ours, self.theirs = core, core.FeatureReceiver(), FeatureReceiver()
        core.receiver_init(self.ours)
        self.complete = core.FeatureSet()

    def receive(self, chunk: FeatureChunk) -> bool:
        theirs = self.theirs.receive(chunk)
        complete = self.core.receiver_receive(self.ours, c_chunk(self.core, chunk), self.complete)
        assert complete == (theirs is not None)
        if theirs is not None:
            same_features(self.core, self.complete, theirs)
        self.compare()
        return bool(complete)

    def reset(self) -> None:
        self.theirs.reset()
        self.core.receiver_reset(self.ours)
        self.compare()

    def compare(self) -> None:
        ours, theirs = self.ours, self.theirs
        bitmap = octets(bytes(CHUNK_COUNT_MAX // 8))
        size = self.core.receiver_received_chunks(ours, bitmap)
        assert octets_of(bitmap)[:size] == theirs.received_chunks
        assert (ours.transfer_version, ours.ignored) == (theirs.transfer_version, theirs.ignored)
        assert (ours.refused_version, ours.refusal) == theirs.refused


def broken(data: bytes, how: str) -> bytes:
    """Bytes that are refused for one reason or another, or accepted."""
    fields = msgpack.unpackb(data)
    if how == "name":
        return bytes(msgpack.packb(changed(fields, (5, 0, 0), "altitude")))
    if how == "version":
        return bytes(msgpack.packb(changed(fields, (2,), fields[2] + 1)))
    return data[:-1] if how == "short" else data


@SETTINGS
@given(
    seed=SEEDS,
    sent=st.lists(
        st.tuples(
            st.integers(1, 4),
            st.sampled_from(["", "", "name", "version", "short", "digest", "count"]),
            st.sampled_from([300, 1100, 40]),
            st.booleans(),
        ),
        min_size=1,
        max_size=5,
    ),
)
def test_chunks_in_any_order(core: Core, seed: int, sent: Any) -> None:
    """Versions that are whole, broken or at odds with themselves, chunks lost, repeated and mixed."""
    rng, both, waiting = np.random.default_rng(seed), Both(core), []
    for number, how, chunk_bytes, mixed in sent:
        data = broken(encoded(3 * number + (1 if chunk_bytes > 40 else 0), version=number), how)
        chunks = list(split(data, number, chunk_bytes))
        if how == "digest":
            chunks = [dataclasses.replace(one, digest=bytes(16)) for one in chunks]
        if how == "count" and len(chunks) > 1:
            chunks[-1] = dataclasses.replace(chunks[-1], index=0, count=len(chunks) - 1)
        waiting += chunks
        waiting += [chunks[0]]
        if mixed:
            rng.shuffle(waiting)  # type: ignore[arg-type]
            continue
        for chunk in waiting:
            both.receive(chunk)
        if rng.random() < 0.3:
            both.reset()
        waiting = []
    for chunk in waiting:
        both.receive(chunk)


def test_the_largest_transfer(core: Core) -> None:
    """All 64 chunks, filled to the last byte but one."""
    data = encode_feature_set(feature_set(2), "float16")
    both = Both(core)
    filler = data + bytes(CHUNK_COUNT_MAX * 1100 - 1 - len(data))
    chunks = split(filler, 7, 1100)
    assert len(chunks) == CHUNK_COUNT_MAX
    assert not any(both.receive(one) for one in reversed(chunks))
    assert REFUSALS[both.ours.refusal] == "undecodable"
    assert octets_of(both.ours.pieces)[: len(filler)] == filler
    assert digest_of(filler) == octets_of(both.ours.digest)


def test_a_set_that_waits_outlives_one_that_is_refused(core: Core) -> None:
    both = Both(core)
    assert all(both.receive(one) for one in split(encoded(1, version=1), 1, 1100))
    for one in split(broken(encoded(2, version=2), "name"), 2, 1100):
        assert not both.receive(one)
    assert both.complete.version == 1
