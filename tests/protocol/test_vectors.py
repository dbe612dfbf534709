"""The test vectors, compared with the codec and with a second reader written only from docs/protocol.md.

The reader below shares no code with the package; it stands for an implementation in another language.
"""

import hashlib
import importlib.util
import json
import re
import struct
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from onboard.flight.modes import FlightMode
from protocol.endpoint import Endpoint
from protocol.feature_codec import decode_feature_set, encode_feature_set
from protocol.messages import REFUSALS, TimeSyncRequest
from protocol.signals import SIGNAL_NAMES

HERE = Path(__file__).resolve().parent
VECTORS: dict[str, Any] = json.loads((HERE.parent / "vectors" / "protocol_v2.json").read_text(encoding="utf-8"))
DATAGRAMS: list[dict[str, Any]] = VECTORS["datagrams"]

TYPES = {1: "SampleBatch", 2: "Status", 3: "TimeSyncRequest", 65: "FeatureChunk", 66: "Pose", 67: "TimeSyncReply"}
SHAPES = {
    ("SampleBatch", "signals"): (-1, 21),
    ("SampleBatch", "delivered"): (-1, 2, 3),
    ("SampleBatch", "adaptive"): (-1, 2, 3),
    ("Pose", "position_ned_m"): (3,),
    ("Pose", "quaternion"): (4,),
}


class Msgpack:
    """Reads the part of msgpack that the protocol uses."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def take(self, count: int) -> bytes:
        self.at += count
        assert self.at <= len(self.data)
        return self.data[self.at - count : self.at]

    def number(self, form: str) -> int:
        value: int = struct.unpack(">" + form, self.take(struct.calcsize(form)))[0]
        return value

    def value(self) -> Any:
        code = self.take(1)[0]
        if code <= 0x7F:
            return code
        if code >= 0xE0:
            return code - 0x100
        if 0x90 <= code <= 0x9F:
            return [self.value() for _ in range(code - 0x90)]
        if 0xA0 <= code <= 0xBF:
            return self.take(code - 0xA0).decode()
        integers = {0xCC: "B", 0xCD: "H", 0xCE: "I", 0xCF: "Q", 0xD0: "b", 0xD1: "h", 0xD2: "i", 0xD3: "q"}
        if code in integers:
            return self.number(integers[code])
        sizes = {0xC4: "B", 0xC5: "H", 0xD9: "B", 0xDC: "H"}
        size = self.number(sizes[code]) if code in sizes else 0
        return {0xC0: lambda: None, 0xD9: lambda: self.take(size).decode()}.get(
            code, lambda: [self.value() for _ in range(size)] if code == 0xDC else self.take(size)
        )()


def shaped(flat: list[float], shape: tuple[int, ...]) -> Any:
    if len(shape) == 1:
        return flat
    inner = 1
    for size in shape[1:]:
        inner *= size
    return [shaped(flat[i : i + inner], shape[1:]) for i in range(0, len(flat), inner)]


@pytest.mark.parametrize("vector", DATAGRAMS, ids=lambda v: f"{v['type']}-{'keyed' if v['key'] else 'open'}")
def test_a_second_reader_agrees(vector: dict[str, Any]) -> None:
    datagram = bytes.fromhex(vector["datagram"])
    person = f"async-dmrac {vector['direction']}".encode()
    key = bytes.fromhex(vector["key"] or "")
    assert hashlib.blake2b(datagram[:-16], digest_size=16, key=key, person=person).digest() == datagram[-16:]
    version, number, vehicle_id, session, sequence, sent_ns = struct.unpack("<BBHQQQ", datagram[:28])
    assert (version, TYPES[number]) == (2, vector["type"])
    expected = (vector["vehicle_id"], vector["session"], vector["sequence"], vector["sent_ns"])
    assert (vehicle_id, session, sequence, sent_ns) == expected
    reader = Msgpack(datagram[28:-16])
    values = reader.value()
    assert reader.at == len(reader.data)
    for value, (name, stated) in zip(values, vector["fields"].items(), strict=True):
        shape = SHAPES.get((vector["type"], name))
        if shape is not None:
            value = shaped(list(struct.unpack(f"<{len(value) // 4}f", value)), shape)
        assert (value.hex() if isinstance(value, bytes) else value) == stated, name


@pytest.mark.parametrize("vector", DATAGRAMS, ids=lambda v: f"{v['type']}-{'keyed' if v['key'] else 'open'}")
def test_the_endpoint_agrees(vector: dict[str, Any]) -> None:
    key = bytes.fromhex(vector["key"]) if vector["key"] else None
    endpoint = Endpoint("offboard" if vector["direction"] == "up" else "onboard", 1, key, vehicle_id=3)
    if vector["type"] == "TimeSyncReply":
        endpoint.encode(TimeSyncRequest(vector["fields"]["origin_ns"]), vector["sent_ns"])
    message = endpoint.decode(bytes.fromhex(vector["datagram"]), vector["sent_ns"])
    assert type(message).__name__ == vector["type"]


@pytest.mark.parametrize(("dtype", "form", "size"), [("float16", "e", 2), ("float32", "f", 4)])
def test_a_second_reader_agrees_on_a_feature_set(dtype: Any, form: str, size: int) -> None:
    data = bytes.fromhex(VECTORS["feature_set"][dtype])
    assert encode_feature_set(decode_feature_set(data), dtype) == data
    fields = Msgpack(data).value()
    assert fields[:6] == [1, size, 9, 8, 12345, None]
    inputs, offset, scale, widths, parameters = fields[6]
    assert (inputs, widths) == (["velocity_n", "pitch"], [3, 2])
    assert struct.unpack("<2f", offset) + struct.unpack("<2f", scale) == (0.0, 0.125, 1.0, 1.125)
    eighths = [*range(6), *range(3), *(-i for i in range(6)), *range(2), *range(9)]
    assert struct.unpack(f"<26{form}", parameters) == tuple(i / 8 for i in eighths)
    if size == 2:
        assert hashlib.blake2b(data, digest_size=16).hexdigest() == VECTORS["digest_float16"]


def make_vectors() -> ModuleType:
    spec = importlib.util.spec_from_file_location("make_vectors", HERE / "make_vectors.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_file_is_what_the_generator_makes() -> None:
    assert make_vectors().content() == VECTORS


def test_the_page_names_every_signal_mode_and_refusal_by_its_number() -> None:
    page = (HERE.parents[1] / "docs" / "protocol.md").read_text(encoding="utf-8")
    stated = re.findall(r"`([a-z_]+[a-z0-9_]*)`", page[page.index("| 0 - 2 |") : page.index("### 2 Status")])
    thrusts = stated.index("motor_thrust_1")
    stated[thrusts : thrusts + 2] = [f"motor_thrust_{number}" for number in range(1, 5)]  # "1 to 4"
    assert tuple(stated) == SIGNAL_NAMES
    assert ", ".join(f"{mode.value} {mode.name}" for mode in FlightMode) in page
    assert re.findall(r"^\| (\d+) ([a-z_]+) \|", page, re.MULTILINE) == [
        (str(number), name) for number, name in enumerate(REFUSALS) if name
    ]
