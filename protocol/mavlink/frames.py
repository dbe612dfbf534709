"""MAVLink 2 frames: datagrams to checked fields, and back. Bytes from a peer never raise.

pymavlink supplies the definitions (field layout, checksum seed). Its stream parser is not used. It keeps a buffer
across datagrams, so a truncated datagram destroys the next good frame. It stores a signature's time before it verifies
the signature, so one forged frame blocks a stream for good. It accepts unknown messages without a signature. Here a
datagram holds whole frames only, messages come from an allow-list, and the order of the checks is checksum, signature,
signature time. Each failure is counted by reason.
"""

import struct
from collections import Counter
from collections.abc import Iterable
from functools import cache
from typing import Any, Final, NamedTuple

from pymavlink.dialects.v20 import common as mavlink

from protocol.mavlink.signing import SignatureCheck, SigningClock, check_key, signature
from protocol.named_tuple import of_members

MARKER: Final = 0xFD
HEADER_BYTES: Final = 10
CHECKSUM_BYTES: Final = 2
SIGNATURE_BYTES: Final = 13
SIGNED_FLAG: Final = 1
FRAMES_PER_DATAGRAM_MAX: Final = 16

_MARKER: Final = bytes((MARKER,))
_LINK_ID: Final = bytes(1)
_HEADER: Final = struct.Struct("<BBBBBBHB")
"""Without the marker: length, two kinds of flags, sequence, system, component, message id."""
_checksum: Any = mavlink.mcrf4xx

if _checksum is None:
    raise ImportError("fastcrc is missing; without it a MAVLink checksum costs more than the rest of the step")

Fields = tuple[Any, ...]
"""The fields of a message in wire order: integers, floats (possibly infinite or NaN) and bytes."""


class Message(NamedTuple):
    """A message to send."""

    kind: Any
    """pymavlink's message class."""
    fields: Fields
    """Without trailing extension fields, which are then sent as 0."""
    fixed: "FixedFields | None" = None
    """The fields behind these, if they are the same in many messages."""


class Frame(NamedTuple):
    """One checked frame."""

    message_id: int
    system: int
    component: int
    sequence: int
    fields: Fields


_frame: Final = of_members(Frame)


class FrameBytes(bytes):
    """A frame that a FrameWriter of this process has written: its bytes, and what a reader finds in them.

    A FrameReader without a key takes `frame` as it is; over a socket, or with a bit flipped, only plain bytes come.
    """

    frame: Frame


class Layout(NamedTuple):
    """The wire format of one message type."""

    message_id: int
    payload: struct.Struct
    """All fields, extensions included."""
    seed: bytes
    """The checksum ends with it: two layouts of one message id have different checksums."""
    field_count: int


class FixedFields:
    """The last fields of a kind of message, where they are the same in many: they are packed once.

    kind: pymavlink's message class. fields: the last ones in wire order, with extension fields. Raises struct.error if
    a field does not fit its type, or there are more than the message has.
    """

    def __init__(self, kind: Any, fields: Fields) -> None:
        codes = _codes(kind.unpacker.format)
        first = max(0, len(codes) - len(fields))
        last = struct.Struct("<" + "".join(codes[first:]))
        self.before: Final = struct.Struct("<" + "".join(codes[:first]))
        """Of the other fields."""
        self.packed: Final = last.pack(*fields)
        self.received: Final[Fields] = last.unpack(self.packed)


def _codes(layout: str) -> list[str]:
    """The code of each field in a layout of the module struct: "<Q3f4s" has the fields Q, f, f, f and 4s."""
    codes, count = list[str](), ""
    for letter in layout.removeprefix("<"):
        if letter.isdigit():
            count += letter
        else:
            codes += [count + letter] if letter == "s" else int(count or 1) * [letter]
            count = ""
    return codes


class AvailableModes:
    """AVAILABLE_MODES, which pymavlink's common dialect does not have yet: what a message class of it needs here."""

    id: Final = 435
    crc_extra: Final = 134
    unpacker: Final = struct.Struct("<IIBBB35s")
    """Custom mode, properties, number of modes, index from 1, standard mode, name."""


_KINDS: Final[dict[int, Any]] = {**mavlink.mavlink_map, AvailableModes.id: AvailableModes}


@cache
def layout_of(message_id: int) -> Layout:
    """The layout of a message type. Raises KeyError if the dialect does not have it."""
    kind = _KINDS[message_id]
    payload: struct.Struct = kind.unpacker
    count = len(payload.unpack(bytes(payload.size)))
    return Layout(message_id, payload, bytes((kind.crc_extra,)), count)


def frame_length(data: bytes, start: int) -> int:
    """Length in bytes of the frame that begins at `start`; `data` must hold its first three bytes."""
    signature_bytes = SIGNATURE_BYTES if data[start + 2] & SIGNED_FLAG else 0
    return HEADER_BYTES + data[start + 1] + CHECKSUM_BYTES + signature_bytes


def message_id_of(data: bytes, start: int = 0) -> int:
    """Message id of the frame that begins at `start`."""
    return data[start + 7] | data[start + 8] << 8 | data[start + 9] << 16


def checked_fields(frame: bytes, layout: Layout) -> Fields | None:
    """The fields of one frame of that layout; None if the frame is truncated or its checksum is wrong."""
    end = HEADER_BYTES + frame[1]
    if len(frame) < end + CHECKSUM_BYTES:
        return None
    if _checksum(frame[1:end] + layout.seed) != frame[end] | frame[end + 1] << 8:
        return None
    payload, size = frame[HEADER_BYTES:end], layout.payload.size
    if len(payload) != size:  # trailing zeros are not sent; unknown extensions are cut off
        payload = payload[:size].ljust(size, b"\0")
    return layout.payload.unpack(payload)


class FrameReader:
    """Splits datagrams into checked frames. `rejected` counts what was dropped, by reason."""

    def __init__(
        self,
        message_ids: Iterable[int],
        key: bytes | None = None,
        clock: SigningClock | None = None,
        tolerance_s: float | None = 60.0,
    ) -> None:
        """Read the messages of the allow-list `message_ids`; with a `key` only signed frames.

        tolerance_s: allowed difference between a signature's time and `clock`; None: any, for a side without a clock.

        Raises ValueError if the key is not 32 bytes long, KeyError if a message id is unknown.
        """
        self._layouts = {message_id: layout_of(message_id) for message_id in message_ids}
        key = check_key(key)
        self._signatures = None if key is None else SignatureCheck(key, clock or SigningClock(), tolerance_s)
        self.rejected: Counter[str] = Counter()

    @property
    def newest_signature_time(self) -> int:
        """The newest verified signature time; 0 without a key."""
        return 0 if self._signatures is None else self._signatures.newest

    def read(self, datagram: bytes, now_ns: int) -> list[Frame]:
        """The good frames of a datagram. Nothing of an incomplete frame is stored."""
        if type(datagram) is FrameBytes and self._signatures is None and datagram.frame.message_id in self._layouts:
            return [datagram.frame]
        frames: list[Frame] = []
        start, end = 0, len(datagram)
        for _ in range(FRAMES_PER_DATAGRAM_MAX):
            if end - start < HEADER_BYTES + CHECKSUM_BYTES:
                if start < end or end == 0:
                    self.rejected["truncated"] += 1
                return frames
            if datagram[start] != MARKER:
                self.rejected["not_mavlink_2"] += 1
                return frames
            stop = start + frame_length(datagram, start)
            if stop > end:
                self.rejected["truncated"] += 1
                return frames
            frame = self._check(datagram[start:stop], now_ns)
            if frame is not None:
                frames.append(frame)
            start = stop
            if start == end:
                return frames
        self.rejected["too_many_frames"] += 1
        return frames

    def screen(self, datagram: bytes) -> tuple[int, int] | None:
        """Message id and system id of the first frame; None if `read` would refuse it. Nothing is stored or counted.

        With a key the signature must be right and newer than the newest of its stream; the clock is not consulted.
        """
        if len(datagram) < HEADER_BYTES + CHECKSUM_BYTES or datagram[0] != MARKER or datagram[2] & ~SIGNED_FLAG:
            return None
        layout = self._layouts.get(message_id_of(datagram))
        signatures = self._signatures
        if layout is None or (signatures is not None and not datagram[2] & SIGNED_FLAG):
            return None
        frame = datagram[: frame_length(datagram, 0)]
        good = checked_fields(frame, layout) is not None if signatures is None else signatures.is_new(frame)
        return (layout.message_id, frame[5]) if good else None

    def _check(self, data: bytes, now_ns: int) -> Frame | None:
        """The frame whose bytes are `data`; None, and counted, if it is refused."""
        if data[2] & ~SIGNED_FLAG:
            self.rejected["unknown_flags"] += 1
            return None
        layout = self._layouts.get(message_id_of(data))
        if layout is None:
            self.rejected["message_not_allowed"] += 1
            return None
        fields = checked_fields(data, layout)
        if fields is None:
            self.rejected["checksum"] += 1
            return None
        if self._signatures is not None:
            fault = self._signatures.fault(data, bool(data[2] & SIGNED_FLAG), now_ns)
            if fault:
                self.rejected[fault] += 1
                return None
        return Frame(layout.message_id, data[5], data[6], data[4], fields)


class FrameWriter:
    """Builds frames, signed if there is a key."""

    def __init__(
        self, system: int, component: int, key: bytes | None = None, clock: SigningClock | None = None
    ) -> None:
        """Raises ValueError if the key is not 32 bytes long."""
        self._key = check_key(key)
        self._clock = clock or SigningClock()
        self._flags = SIGNED_FLAG if key is not None else 0
        self._system = system
        self._component = component
        self._sequence = 0
        self._layouts: dict[Any, Layout] = {}
        """Of the kinds of messages that were written."""

    def write(self, message: Message, now_ns: int) -> bytes:
        """The frame of a message; without a key as FrameBytes, whose fields are those that the bytes hold.

        Raises struct.error if a field does not fit its type (an error of the caller).
        """
        kind, fields, fixed = message
        layout = self._layouts.get(kind)
        if layout is None:
            layout = self._layouts[kind] = layout_of(kind.id)
        message_id, all_fields, seed, count = layout
        if fixed is None:
            packed = all_fields.pack(*fields, *(0,) * (count - len(fields)))
        else:
            before = fixed.before.pack(*fields)
            packed = before + fixed.packed
        payload = packed.rstrip(b"\0") or b"\0"
        sequence, system, component = self._sequence, self._system, self._component
        self._sequence = (sequence + 1) & 0xFF
        kind_low, kind_high = message_id & 0xFFFF, message_id >> 16
        body = _HEADER.pack(len(payload), self._flags, 0, sequence, system, component, kind_low, kind_high) + payload
        checksum: int = _checksum(body + seed)
        frame = _MARKER + body + checksum.to_bytes(2, "little")
        if self._key is None:
            written = FrameBytes(frame)
            received = all_fields.unpack(packed) if fixed is None else fixed.before.unpack(before) + fixed.received
            written.frame = _frame((message_id, system, component, sequence, received))
            return written
        frame += _LINK_ID + self._clock.next(now_ns).to_bytes(6, "little")
        return frame + signature(self._key, frame)
