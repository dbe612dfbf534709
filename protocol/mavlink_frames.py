"""MAVLink 2 frames: bytes to checked field tuples, and back. Sans I/O, and nothing a peer sends raises.

pymavlink supplies the definitions (field layout, checksum seed); its stream parser is not used, for three reasons.
It keeps a buffer across datagrams, so a truncated one destroys the next good frame; it stores a signature's time
before it verifies the signature, so one forged frame blocks a stream for good; and it lets unknown messages past
the signature check. Here a datagram is whole frames or nothing, messages come from an allow-list, and the order is
checksum, signature, then time, each counted by reason when it fails.
"""

import hashlib
import hmac
import struct
from collections import Counter
from collections.abc import Iterable
from functools import cache
from typing import Any, Final, NamedTuple

from pymavlink.dialects.v20 import common as mavlink

MARKER: Final = 0xFD
HEADER_BYTES: Final = 10
CHECKSUM_BYTES: Final = 2
SIGNATURE_BYTES: Final = 13
SIGNED_FLAG: Final = 1
FRAMES_PER_DATAGRAM_MAX: Final = 16
STREAMS_MAX: Final = 16
"""Signed streams (link, system, component) that are remembered."""
KEY_BYTES: Final = 32

_MARKER: Final = bytes((MARKER,))
_HEADER: Final = struct.Struct("<BBBBBBHB")
"""Without the marker: length, two kinds of flags, sequence, system, component, message id."""
_EPOCH_2015_NS: Final = 1_420_070_400 * 10**9
_SIGNATURE_TICK_NS: Final = 10_000
_checksum: Any = mavlink.mcrf4xx

if _checksum is None:
    raise ImportError("fastcrc is missing; without it a MAVLink checksum costs more than the rest of the step")


class Frame(NamedTuple):
    """One checked frame. `fields` are in wire order, integers and floats as sent (floats may be infinite or NaN)."""

    message_id: int
    system: int
    component: int
    sequence: int
    fields: tuple[Any, ...]


class SigningClock:
    """The signature time: 10 us ticks since 2015, from the caller's clock, strictly increasing."""

    def __init__(self, utc_at_zero_ns: int = _EPOCH_2015_NS, utc_at_first_use_ns: int | None = None) -> None:
        """UTC in ns since 1970, either when the caller's clock showed 0 or when it is first given to this object."""
        self._zero_ns = utc_at_zero_ns - _EPOCH_2015_NS
        self._first_use_ns = utc_at_first_use_ns
        self._last = 0

    def now(self, now_ns: int) -> int:
        """The tick that `now_ns` falls in; 0 before 2015."""
        if self._first_use_ns is not None:
            self._zero_ns = self._first_use_ns - _EPOCH_2015_NS - now_ns
            self._first_use_ns = None
        return max(0, (self._zero_ns + now_ns) // _SIGNATURE_TICK_NS)

    def next(self, now_ns: int) -> int:
        """A tick to sign with: never one that was used before."""
        self._last = max(self.now(now_ns), self._last + 1)
        return self._last

    def catch_up(self, stamp: int) -> None:
        """Takes over another clock's tick, for a side that has no clock of its own."""
        self._last = max(self._last, stamp)


def signature(key: bytes, frame: bytes) -> bytes:
    """First 48 bits of SHA-256 over key and `frame`, which ends with link id and time stamp (MAVLink 2 signing)."""
    return hashlib.sha256(key + frame).digest()[:6]


def check_key(key: bytes | None) -> bytes | None:
    """`key`, if it is one.

    Raises
    ------
    ValueError
        If it is not 32 bytes long.
    """
    if key is not None and len(key) != KEY_BYTES:
        raise ValueError(f"a signing key of {len(key)} bytes, expected {KEY_BYTES}")
    return key


class Layout(NamedTuple):
    """How one message type lies on the wire."""

    message_id: int
    payload: struct.Struct
    """All fields, extensions included."""
    seed: bytes
    """What the checksum ends with, so that two layouts of one id do not pass for each other."""
    field_count: int


@cache
def layout_of(message_id: int) -> Layout:
    """The layout of a message type. Raises KeyError if the dialect does not know it."""
    kind = mavlink.mavlink_map[message_id]
    payload: struct.Struct = kind.unpacker
    count = len(payload.unpack(bytes(payload.size)))
    return Layout(message_id, payload, bytes((kind.crc_extra,)), count)


def checked_fields(frame: bytes, layout: Layout) -> tuple[Any, ...] | None:
    """The fields of one frame of that layout, in wire order; None if its checksum is wrong, or it is cut."""
    end = HEADER_BYTES + frame[1]
    if len(frame) < end + CHECKSUM_BYTES:
        return None
    if _checksum(frame[1:end] + layout.seed) != frame[end] | frame[end + 1] << 8:
        return None
    payload, size = frame[HEADER_BYTES:end], layout.payload.size
    if len(payload) != size:  # trailing zeros are not sent; extensions that we do not know are cut off
        payload = payload[:size].ljust(size, b"\0")
    return layout.payload.unpack(payload)


class FrameReader:
    """Takes datagrams apart. `rejected` counts what was dropped, by reason."""

    def __init__(
        self,
        message_ids: Iterable[int],
        key: bytes | None = None,
        clock: SigningClock | None = None,
        tolerance_s: float = 60.0,
    ) -> None:
        """`message_ids`: the allow-list. `tolerance_s`: how far a signature's time may be from ours.

        Raises ValueError if the key is not one, KeyError if a message id is unknown.
        """
        self._layouts = {message_id: layout_of(message_id) for message_id in message_ids}
        self._key = check_key(key)
        self._clock = clock or SigningClock()
        self._tolerance = int(tolerance_s * 1e9) // _SIGNATURE_TICK_NS
        self._stream_times: dict[tuple[int, int, int], int] = {}
        self.rejected: Counter[str] = Counter()

    def read(self, datagram: bytes, now_ns: int) -> list[Frame]:
        """The good frames of a datagram. Nothing is kept of an incomplete one."""
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
            flags = datagram[start + 2]
            stop = start + HEADER_BYTES + CHECKSUM_BYTES + datagram[start + 1]
            if flags & SIGNED_FLAG:
                stop += SIGNATURE_BYTES
            if stop > end:
                self.rejected["truncated"] += 1
                return frames
            frame = self._check(datagram[start:stop], flags, now_ns)
            if frame is not None:
                frames.append(frame)
            start = stop
            if start == end:
                return frames
        self.rejected["too_many_frames"] += 1
        return frames

    def _check(self, data: bytes, flags: int, now_ns: int) -> Frame | None:
        """One frame, cut to its length."""
        if flags & ~SIGNED_FLAG:
            self.rejected["unknown_flags"] += 1
            return None
        message_id = data[7] | data[8] << 8 | data[9] << 16
        layout = self._layouts.get(message_id)
        if layout is None:
            self.rejected["message_not_allowed"] += 1
            return None
        fields = checked_fields(data, layout)
        if fields is None:
            self.rejected["checksum"] += 1
            return None
        if self._key is not None:
            fault = self._signature_fault(data, flags, now_ns)
            if fault:
                self.rejected[fault] += 1
                return None
        return Frame(message_id, data[5], data[6], data[4], fields)

    def _signature_fault(self, data: bytes, flags: int, now_ns: int) -> str:
        """Why a signature is refused; "" when it is good. Nothing is stored before it is verified."""
        if not flags & SIGNED_FLAG:
            return "unsigned"
        assert self._key is not None
        if not hmac.compare_digest(signature(self._key, data[:-6]), data[-6:]):
            return "signature"
        stamp = int.from_bytes(data[-12:-6], "little")
        ours = self._clock.now(now_ns)
        if stamp > ours + self._tolerance:
            return "signature_from_the_future"
        stream = (data[-13], data[5], data[6])
        newest = self._stream_times.get(stream)
        if newest is None:
            if stamp + self._tolerance < ours:
                return "signature_too_old"
            if len(self._stream_times) >= STREAMS_MAX:
                return "too_many_streams"
        elif stamp <= newest:
            return "signature_replayed"
        self._stream_times[stream] = stamp
        return ""


class FrameWriter:
    """Builds frames, signed when there is a key."""

    def __init__(
        self, system: int, component: int, key: bytes | None = None, clock: SigningClock | None = None, link_id: int = 0
    ) -> None:
        """Raises ValueError if the key is not one."""
        self._key = check_key(key)
        self._clock = clock or SigningClock()
        self._link = bytes([link_id])
        self._flags = SIGNED_FLAG if key is not None else 0
        self._system = system
        self._component = component
        self._sequence = 0

    def write(self, kind: Any, fields: tuple[Any, ...], now_ns: int) -> bytes:
        """A frame of the pymavlink message class `kind` with `fields` in wire order.

        Numeric extensions that a newer pymavlink has added at the end are sent as 0, that is, not at all.

        Raises
        ------
        struct.error
            If a field does not fit its type: our own mistake.
        """
        message_id: int = kind.id
        layout = layout_of(message_id)
        missing = layout.field_count - len(fields)
        if missing > 0:
            fields += (0,) * missing
        payload = layout.payload.pack(*fields).rstrip(b"\0") or b"\0"
        sequence = self._sequence
        self._sequence = (sequence + 1) & 0xFF
        head = _HEADER.pack(
            len(payload), self._flags, 0, sequence, self._system, self._component, message_id & 0xFFFF, message_id >> 16
        )
        body = head + payload
        checksum: int = _checksum(body + layout.seed)
        frame = _MARKER + body + checksum.to_bytes(2, "little")
        if self._key is None:
            return frame
        frame += self._link + self._clock.next(now_ns).to_bytes(6, "little")
        return frame + signature(self._key, frame)
