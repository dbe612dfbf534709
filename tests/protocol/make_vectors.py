"""Writes tests/vectors/protocol_v2.json: datagrams and feature sets with their values.

Run `python tests/protocol/make_vectors.py` after a change of the protocol's version, never to make a test pass.
"""

import json
from dataclasses import fields
from pathlib import Path
from typing import Any, Final

import numpy as np

from protocol.endpoint import Endpoint, Role
from protocol.feature_codec import encode_feature_set
from protocol.feature_set import ChannelFeatures, FeatureSet
from protocol.messages import FeatureChunk, Message, Pose, SampleBatch, Status, TimeSyncReply, TimeSyncRequest
from protocol.transfer import split

PATH: Final = Path(__file__).resolve().parents[1] / "vectors" / "protocol_v2.json"
KEY: Final = bytes(range(32))
SESSIONS: Final[dict[Role, int]] = {"onboard": 0x018C_BAF6_1400_0001, "offboard": 0x018C_BAF6_1500_0002}


def counting(*shape: int) -> Any:
    """Values that are exact in float16 and float32: 0, 1/8, 2/8, ..."""
    return (np.arange(np.prod(shape)) / 8.0).reshape(shape)


def feature_set() -> FeatureSet:
    """One channel, 2 inputs, layers of 3 and 2."""
    weights, biases = (counting(3, 2), -counting(2, 3)), (counting(3), counting(2))
    channel = ChannelFeatures(("velocity_n", "pitch"), counting(2), counting(2) + 1, weights, biases, counting(3, 3))
    return FeatureSet(9, 8, 12345, None, channel)


def messages() -> dict[Role, tuple[Message, ...]]:
    """Messages of each role."""
    arrays = (array.astype(np.float32) for array in (counting(2, 21), -counting(2, 2, 3), counting(2, 2, 3)))
    chunk = split(encode_feature_set(feature_set(), "float16"), 9, 64)[1]
    position, quaternion = np.array([1.5, -2.25, -1.0]), np.array([0.5, -0.5, 0.5, -0.5])
    return {
        "onboard": (
            SampleBatch(41, 1_234_567_890, 20_000_000, 8, *arrays),
            Status(4, 8, 9, b"\x05", 7, 5, 40_000, 3, -1, 1_000, 20, 1),
            TimeSyncRequest(5_000_000_000),
        ),
        "offboard": (
            chunk,
            Pose(77_000_000_000, position.astype(np.float32), quaternion.astype(np.float32)),
            TimeSyncReply(5_000_000_000, 77_100_000_000, 77_100_050_000),
        ),
    }


def plain(value: Any) -> Any:
    """A field's value for JSON: arrays as nested lists, bytes as hexadecimal."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    return value.hex() if isinstance(value, bytes) else value


def content() -> dict[str, Any]:
    """The content of the file."""
    datagrams = []
    for key in (KEY, None):
        for role, sent in messages().items():
            endpoint = Endpoint(role, SESSIONS[role], key, vehicle_id=3)
            for sequence, message in enumerate(sent):
                sent_ns = 6_000_000_000 + sequence
                datagrams.append(
                    {
                        "key": key.hex() if key else None,
                        "direction": "up" if role == "onboard" else "down",
                        "vehicle_id": 3,
                        "session": SESSIONS[role],
                        "sequence": sequence,
                        "sent_ns": sent_ns,
                        "type": type(message).__name__,
                        "fields": {field.name: plain(getattr(message, field.name)) for field in fields(message)},
                        "datagram": endpoint.encode(message, sent_ns).hex(),
                    }
                )
    sets = {dtype: encode_feature_set(feature_set(), dtype).hex() for dtype in ("float16", "float32")}
    return {"protocol_version": 2, "datagrams": datagrams, "feature_set": sets, "digest_float16": digest()}


def digest() -> str:
    """Digest of the float16 feature set, as in its chunks."""
    chunk = messages()["offboard"][0]
    assert isinstance(chunk, FeatureChunk)
    return chunk.digest.hex()


if __name__ == "__main__":
    PATH.write_text(json.dumps(content(), indent=1) + "\n", encoding="utf-8")
