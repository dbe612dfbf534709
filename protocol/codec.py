"""The bytes of a datagram's header and body, as docs/protocol.md specifies them.

A datagram is a header (28 bytes), a body and a MAC (16 bytes, `protocol.authentication`).

A body is one msgpack array with the message's fields in the order of `protocol.messages`. Integers are msgpack
integers. Arrays are little-endian float32 in msgpack bin; the message type determines their shape. Nothing else is
accepted: no maps, no text, no extension types, no nesting. `protocol.feature_codec` has the bytes
of a feature set.
"""

import math
import struct
from collections.abc import Callable
from dataclasses import fields
from operator import attrgetter
from typing import Any, Final

import msgpack
import numpy as np
from numpy.typing import NDArray

from protocol.errors import ProtocolError
from protocol.messages import (
    CHUNK_DATA_MAX_BYTES,
    SAMPLES_PER_BATCH_MAX,
    FeatureChunk,
    Message,
    Pose,
    SampleBatch,
    Status,
    TimeSyncReply,
    TimeSyncRequest,
)
from protocol.msgpack_array import unpack_array
from protocol.signals import CHANNELS, SIGNAL_COUNT

PROTOCOL_VERSION: Final = 2
HEADER: Final = struct.Struct("<BBHQQQ")
"""Version, type, vehicle id, session, sequence, sender time in ns; little-endian, no padding, 28 bytes."""
_FLOAT32: Final = np.dtype("<f4")
_SIGNAL_BYTES: Final = 4 * SIGNAL_COUNT
_FIELDS_MAX: Final = 12


Pack = Callable[[Any], tuple[Any, ...]]
"""The fields of a message."""
Unpack = Callable[[list[Any]], Message]
"""The message of fields. Raises ProtocolError or ValueError."""


def _float32(array: NDArray[np.floating]) -> bytes:
    return (array if array.dtype == _FLOAT32 else array.astype(_FLOAT32)).tobytes()


def _pack_sample_batch(m: SampleBatch) -> tuple[Any, ...]:
    arrays = (_float32(m.signals), _float32(m.delivered), _float32(m.adaptive))
    return (m.first_index, m.time_ns, m.period_ns, m.feature_version, *arrays)


def _unpack_sample_batch(fields: list[Any]) -> SampleBatch:
    first_index, time_ns, period_ns, version, signals, delivered, adaptive = _typed(fields, "iiiibbb")
    n, rest = divmod(len(signals), _SIGNAL_BYTES)
    if rest or not 1 <= n <= SAMPLES_PER_BATCH_MAX:
        raise ProtocolError("body", f"signals of {len(signals)} bytes")
    per_channel = (n, len(CHANNELS), 3)
    arrays = (_array(signals, (n, SIGNAL_COUNT)), _array(delivered, per_channel), _array(adaptive, per_channel))
    return SampleBatch(first_index, time_ns, period_ns, version, *arrays)


def _pack_pose(m: Pose) -> tuple[Any, ...]:
    return (m.time_ns, _float32(m.position_ned_m), _float32(m.quaternion))


def _unpack_pose(fields: list[Any]) -> Pose:
    time_ns, position, quaternion = _typed(fields, "ibb")
    return Pose(time_ns, _array(position, (3,)), _array(quaternion, (4,)))


def _plain(cls: type[Any], kinds: str) -> tuple[type[Any], Pack, Unpack]:
    """The row of a message whose fields, of these `kinds` (see `_typed`), are sent as they are."""
    names = [field.name for field in fields(cls)]
    get = attrgetter(*names)
    pack = get if len(names) > 1 else lambda m: (get(m),)
    return cls, pack, lambda values: cls(*_typed(values, kinds))


# One row per message type: its number on the wire, its class, message to fields, fields to message.
_ROWS: Final[tuple[tuple[int, type[Any], Pack, Unpack], ...]] = (
    (1, SampleBatch, _pack_sample_batch, _unpack_sample_batch),
    (2, *_plain(Status, "iiibiiiiiiii")),
    (3, *_plain(TimeSyncRequest, "ib")),
    (65, *_plain(FeatureChunk, "iiibb")),
    (66, Pose, _pack_pose, _unpack_pose),
    (67, *_plain(TimeSyncReply, "iiib")),
)
TYPE_NUMBERS: Final[dict[type[Any], int]] = {cls: number for number, cls, _, _ in _ROWS}
_BOTH_WAYS: Final = frozenset({TYPE_NUMBERS[TimeSyncRequest], TYPE_NUMBERS[TimeSyncReply]})
"""Both sides may ask for the clock of the other: onboard regularly, offboard as a challenge (protocol.session)."""
UP_TYPES: Final = frozenset(number for number, *_ in _ROWS if number < 64) | _BOTH_WAYS
"""Types that onboard sends."""
DOWN_TYPES: Final = frozenset(number for number, *_ in _ROWS if number >= 64) | _BOTH_WAYS
"""Types that offboard sends."""
_PACK: Final = {cls: pack for _, cls, pack, _ in _ROWS}
_UNPACK: Final = {number: unpack for number, _, _, unpack in _ROWS}
_packer: Final = msgpack.Packer()
"""Making one for each body, as msgpack.packb does, takes longer than packing."""
_LETTERS: Final[dict[type, str]] = {int: "i", bytes: "b"}


def encode_body(message: Message) -> bytes:
    """The msgpack body of a message."""
    body: bytes = _packer.pack(_PACK[type(message)](message))
    return body


def decode_body(type_number: int, body: bytes) -> Message:
    """The message of a body of the given type.

    Raises
    ------
    ProtocolError
        "body" if the bytes are not the msgpack array of the type, "value" if a value is not allowed.
    """
    fields = unpack_array(body, "body", CHUNK_DATA_MAX_BYTES, _FIELDS_MAX)
    try:
        return _UNPACK[type_number](fields)
    except ValueError as error:
        raise ProtocolError("value", str(error)) from None


def _typed(fields: list[Any], kinds: str) -> list[Any]:
    """`fields`, checked for the number and types in `kinds` ("i": int, "b": bytes). Raises ProtocolError."""
    if len(fields) != len(kinds):
        raise ProtocolError("body", f"{len(fields)} fields, expected {len(kinds)}")
    if "".join([_LETTERS.get(type(field), "?") for field in fields]) != kinds:  # not isinstance: True is an int
        raise ProtocolError("body", f"fields of {[type(field).__name__ for field in fields]}, expected {kinds}")
    return fields


def _array(data: bytes, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """A read-only float32 array over `data`. Raises ProtocolError if the size does not fit the shape."""
    array = np.frombuffer(data, dtype="<f4") if len(data) % 4 == 0 else np.empty(0, dtype="<f4")
    if array.size != math.prod(shape):
        raise ProtocolError("body", f"an array of {len(data)} bytes, expected shape {shape}")
    return array.reshape(shape)
