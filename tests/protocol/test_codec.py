from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import msgpack
import numpy as np
import pytest

from protocol.codec import TYPE_NUMBERS, decode_body, encode_body
from protocol.errors import ProtocolError
from protocol.feature_codec import decode_feature_set, encode_feature_set
from protocol.feature_set import FeatureSet
from protocol.messages import NO_LAYOUT, REFUSALS, FeatureChunk, Message, Pose, SampleBatch

Make = Callable[..., FeatureSet]


def assert_same(one: Any, other: Any) -> None:
    for field in fields(one):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if isinstance(a, np.ndarray):
            assert a.dtype == b.dtype
            np.testing.assert_array_equal(a, b)
        else:
            assert a == b, field.name


def test_message_round_trip(any_message: Message) -> None:
    assert_same(decode_body(TYPE_NUMBERS[type(any_message)], encode_body(any_message)), any_message)


def test_decoded_arrays_cannot_be_written() -> None:
    pose = Pose(0, np.zeros(3, np.float32), np.array([1, 0, 0, 0], np.float32))
    back = decode_body(TYPE_NUMBERS[Pose], encode_body(pose))
    assert isinstance(back, Pose)
    with pytest.raises(ValueError, match="read-only"):
        back.position_ned_m[0] = 1.0


FLOAT = np.float32(1.0).tobytes()


@pytest.mark.parametrize(
    ("number", "body", "reason"),
    [
        (3, b"", "body"),
        (3, b"\xc1", "body"),
        (3, msgpack.packb(5), "body"),
        (3, msgpack.packb({"origin_ns": 5}), "body"),
        (3, msgpack.packb([5, 6]), "body"),
        (3, msgpack.packb([True]), "body"),
        (3, msgpack.packb([5.0]), "body"),
        (3, msgpack.packb(["five"]), "body"),
        (3, msgpack.packb([b"five"]), "body"),
        (3, msgpack.packb([None]), "body"),
        (3, msgpack.packb([[5]]), "body"),
        (3, msgpack.packb([5]) + b"\x00", "body"),
        (3, b"\x91" * 1100, "body"),
        (3, b"\xdd\xff\xff\xff\xff", "body"),
        (3, b"\x91\xc6\xff\xff\xff\xff", "body"),
        (3, b"\x91\xd6\xff\x00\x00\x00\x00", "body"),
        (3, msgpack.packb([-1, NO_LAYOUT]), "value"),
        (3, msgpack.packb([2**63, NO_LAYOUT]), "value"),
        (3, msgpack.packb([5, NO_LAYOUT[1:]]), "value"),
        (66, msgpack.packb([0, FLOAT * 3, FLOAT * 3]), "body"),
        (66, msgpack.packb([0, FLOAT * 3, FLOAT * 4]), "value"),
        (66, msgpack.packb([0, FLOAT * 3 + b"\x00", FLOAT * 4]), "body"),
        (66, msgpack.packb([0, np.float32(np.nan).tobytes() * 3, FLOAT + b"\x00" * 12]), "value"),
        (66, msgpack.packb([0, np.float32(np.inf).tobytes() * 3, FLOAT + b"\x00" * 12]), "value"),
        (66, msgpack.packb([0, np.float32(2e6).tobytes() * 3, FLOAT + b"\x00" * 12]), "value"),
        (66, msgpack.packb([0, FLOAT * 3, np.float32(np.nan).tobytes() * 4]), "value"),
        (1, msgpack.packb([0, 0, 1, 0, b"", b"", b""]), "body"),
        (1, msgpack.packb([0, 0, 1, 0, FLOAT * 21, FLOAT * 6, FLOAT * 12]), "body"),
        (1, msgpack.packb([0, 0, 1, 0, FLOAT * 21 * 9, FLOAT * 6 * 9, FLOAT * 6 * 9]), "body"),
        (1, msgpack.packb([0, 0, 0, 0, FLOAT * 21, FLOAT * 6, FLOAT * 6]), "value"),
        (2, msgpack.packb([0, 0, 0, b"\x00" * 9, 0, 0, 0, 0, 0, 0, 0, 0]), "value"),
        (2, msgpack.packb([0, 0, 0, b"", 0, len(REFUSALS), 0, 0, 0, 0, 0, 0]), "value"),
        (65, msgpack.packb([1, 0, 65, b"\x00" * 16, b"x"]), "value"),
        (65, msgpack.packb([1, 8, 8, b"\x00" * 16, b"x"]), "value"),
        (65, msgpack.packb([1, 0, 8, b"\x00" * 15, b"x"]), "value"),
        (65, msgpack.packb([1, 0, 8, b"\x00" * 16, b"x" * 1101]), "body"),
        (67, msgpack.packb([0, 9, 8, NO_LAYOUT]), "value"),
    ],
)
def test_a_wrong_body_is_named(number: int, body: bytes, reason: str) -> None:
    with pytest.raises(ProtocolError) as caught:
        decode_body(number, body)
    assert caught.value.reason == reason


def test_a_batch_that_is_not_finite_cannot_be_made() -> None:
    signals = np.zeros((1, 21), np.float32)
    signals[0, 3] = np.nan
    zeros = np.zeros((1, 2, 3), np.float32)
    with pytest.raises(ValueError, match="signals"):
        SampleBatch(0, 0, 1, 0, signals, zeros, zeros)


@pytest.mark.parametrize(("dtype", "tolerance"), [("float32", 1e-7), ("float16", 1e-3)])
def test_feature_set_round_trip(make_features: Make, dtype: Any, tolerance: float) -> None:
    features = make_features(version=5)
    back = decode_feature_set(encode_feature_set(features, dtype))
    assert (back.version, back.parent, back.samples) == (5, 4, 1000)
    assert features.position is not None
    assert back.position is not None
    assert back.position.inputs == features.position.inputs
    for a, b in zip(back.position.weights, features.position.weights, strict=True):
        np.testing.assert_allclose(a, b, rtol=tolerance, atol=tolerance * 1e-3)
        assert a.dtype == np.float64
    np.testing.assert_allclose(back.position.offset, features.position.offset, rtol=1e-7)
    assert encode_feature_set(back, dtype) == encode_feature_set(features, dtype), "rounding twice changes nothing more"


def test_a_feature_set_may_cover_one_channel(make_features: Make) -> None:
    features = replace(make_features(), position=None)
    back = decode_feature_set(encode_feature_set(features, "float32"))
    assert back.position is None
    assert back.attitude is not None


def test_what_cannot_be_sent_is_refused_by_the_sender(make_features: Make) -> None:
    features = make_features()
    assert features.position is not None
    huge = replace(features.position, last_layer=np.full((21, 3), 7e4))
    with pytest.raises(ValueError, match="too large"):
        encode_feature_set(replace(features, position=huge), "float16")
    encode_feature_set(replace(features, position=huge), "float32")
    m = len(features.position.inputs)
    wide = replace(
        features.position,
        weights=(np.zeros((128, m)), np.zeros((128, 128))),
        biases=(np.zeros(128),) * 2,
        last_layer=np.zeros((129, 3)),
    )
    with pytest.raises(ValueError, match="bytes"):
        encode_feature_set(replace(features, position=wide, attitude=wide), "float32")


def tampered(features: FeatureSet, at: int, value: Any) -> bytes:
    """An encoded feature set with one field of its position channel replaced."""
    tree = msgpack.unpackb(encode_feature_set(features, "float16"))
    tree[5][at] = value
    data: bytes = msgpack.packb(tree)
    return data


@pytest.mark.parametrize(
    ("at", "value", "reason"),
    [
        (0, ["velocity_n", "nonsense"], "inputs"),
        (0, ["velocity_n", 5], "inputs"),
        (0, [], "undecodable"),
        (0, ["velocity_n"] * 6, "undecodable"),
        (0, None, "undecodable"),
        (1, b"\x00" * 20, "undecodable"),
        (1, np.full(6, np.nan, np.float32).tobytes(), "not_finite"),
        (2, np.zeros(6, np.float32).tobytes(), "undecodable"),
        (3, [32, 32], "undecodable"),
        (3, [32, 32, 20, 20, 20], "undecodable"),
        (3, [32, 129, 20], "undecodable"),
        (3, [32, -32, 20], "undecodable"),
        (3, [32, True, 20], "undecodable"),
        (4, b"\x00", "undecodable"),
        (4, np.full(2003, np.inf, np.float16).tobytes(), "not_finite"),
    ],
)
def test_a_wrong_feature_set_is_named(make_features: Make, at: int, value: Any, reason: str) -> None:
    with pytest.raises(ProtocolError) as caught:
        decode_feature_set(tampered(make_features(), at, value))
    assert caught.value.reason == reason
    assert caught.value.reason in REFUSALS


@pytest.mark.parametrize("data", [b"", b"\xc0", msgpack.packb([2, 2, 1, 0, 0, None, None]), msgpack.packb([1] * 7)])
def test_no_feature_set_at_all(data: bytes) -> None:
    with pytest.raises(ProtocolError) as caught:
        decode_feature_set(data)
    assert caught.value.reason == "undecodable"


def test_every_form_that_msgpack_has_for_a_value_is_taken() -> None:
    """A library of another language may not use the shortest form."""
    longest = b"\xdd\x00\x00\x00\x05" + b"".join(b"\xd3" + value.to_bytes(8, "big") for value in (1, 0, 8))
    longest += b"\xc6\x00\x00\x00\x10" + bytes(16) + b"\xc6\x00\x00\x00\x01x"
    assert decode_body(65, longest) == FeatureChunk(1, 0, 8, bytes(16), b"x")
