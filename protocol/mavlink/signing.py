"""MAVLink 2 signing: the signature, its clock, and the check that refuses forged and repeated frames."""

import hashlib
import hmac
from typing import Final

KEY_BYTES: Final = 32
SIGNATURE_FAULTS: Final = (
    *("unsigned", "signature", "signature_from_the_future", "signature_too_old", "signature_replayed"),
    "too_many_streams",
)
"""Why `SignatureCheck.fault` refuses a frame."""
STREAMS_MAX: Final = 16
"""Signed streams (link, system, component) that one receiver remembers."""
_SETUP_SIGNING: Final = (256).to_bytes(3, "little")
_ID_AT: Final = 7
_MARKER: Final = 0xFD
SIGNED_LEAST_BYTES: Final = 25
"""Of a signed frame without a payload."""
_EPOCH_2015_NS: Final = 1_420_070_400 * 10**9
_TICK_NS: Final = 10_000
_ALL_TICKS: Final = 2**48


class SigningClock:
    """The signature time: 10 us ticks since 2015, from the caller's clock, strictly increasing."""

    def __init__(self, utc_at_first_use_ns: int | None = None) -> None:
        """UTC at the first call, ns since 1970; None: the caller's clock starts in 2015."""
        self._zero_ns = 0
        self._first_use_ns = utc_at_first_use_ns
        self._last = 0

    def now(self, now_ns: int) -> int:
        """The tick at `now_ns`; 0 before 2015."""
        if self._first_use_ns is not None:
            self._zero_ns = self._first_use_ns - _EPOCH_2015_NS - now_ns
            self._first_use_ns = None
        return max(0, (self._zero_ns + now_ns) // _TICK_NS)

    def next(self, now_ns: int) -> int:
        """A tick to sign with; each tick is used once."""
        self._last = max(self.now(now_ns), self._last + 1)
        return self._last

    def catch_up(self, stamp: int) -> None:
        """Adopt the tick of another clock, on a side without a clock of its own."""
        self._last = max(self._last, stamp)


def holds_key(datagram: bytes) -> bool:
    """Whether a frame of the datagram may be SETUP_SIGNING, with which a ground station sends a key in clear.

    It is looked for anywhere in the datagram: also a frame that is not whole must not be logged.
    """
    at = datagram.find(_SETUP_SIGNING)
    while at >= 0:
        if at >= _ID_AT and datagram[at - _ID_AT] == _MARKER:
            return True
        at = datagram.find(_SETUP_SIGNING, at + 1)
    return False


def signature(key: bytes, frame: bytes) -> bytes:
    """First 48 bits of SHA-256 over key and `frame`, which ends with link id and time stamp."""
    return hashlib.sha256(key + frame).digest()[:6]


def check_key(key: bytes | None) -> bytes | None:
    """Return `key`. Raises ValueError if it is not 32 bytes long."""
    if key is not None and len(key) != KEY_BYTES:
        raise ValueError(f"a signing key of {len(key)} bytes, expected {KEY_BYTES}")
    return key


class SignatureCheck:
    """Verifies signatures. It stores nothing of a frame before its signature is verified."""

    def __init__(self, key: bytes, clock: SigningClock, tolerance_s: float | None) -> None:
        """`tolerance_s`: allowed difference between a signature's time and ours; None: any.

        With a tolerance, what was signed before this side began is refused: a receiver that has just started knows no
        stream, and would take a recording of its predecessor's for a new one.
        """
        self._key = key
        self._began: int | None = None
        self._clock = clock
        self._tolerance = _ALL_TICKS if tolerance_s is None else int(tolerance_s * 1e9) // _TICK_NS
        self._stream_times: dict[tuple[int, int, int], int] = {}
        self.newest = 0
        """Newest verified signature time."""

    def is_new(self, frame: bytes) -> bool:
        """Whether the signature of a signed frame is right and newer than its stream's newest. Stores nothing."""
        if len(frame) <= SIGNED_LEAST_BYTES or not hmac.compare_digest(signature(self._key, frame[:-6]), frame[-6:]):
            return False
        return int.from_bytes(frame[-12:-6], "little") > self._stream_times.get((frame[-13], frame[5], frame[6]), -1)

    def fault(self, frame: bytes, signed: bool, now_ns: int) -> str:
        """Why the signature of `frame` is refused; "" if it is good."""
        if not signed:
            return "unsigned"
        if not hmac.compare_digest(signature(self._key, frame[:-6]), frame[-6:]):
            return "signature"
        stamp = int.from_bytes(frame[-12:-6], "little")
        ours = self._clock.now(now_ns)
        self._began = ours if self._began is None else self._began
        if stamp > ours + self._tolerance:
            return "signature_from_the_future"
        stream = (frame[-13], frame[5], frame[6])
        newest = self._stream_times.get(stream)
        if newest is None:
            if stamp + self._tolerance < ours or (stamp < self._began and self._tolerance < _ALL_TICKS):
                return "signature_too_old"
            if len(self._stream_times) >= STREAMS_MAX:
                return "too_many_streams"
        elif stamp <= newest:
            return "signature_replayed"
        self._stream_times[stream] = stamp
        self.newest = max(self.newest, stamp)
        return ""
