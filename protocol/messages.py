"""The messages between onboard and offboard: frozen records that check their values on construction.

Up is from onboard to offboard, down from offboard to onboard. Times are in ns of the sender's monotonic clock.
`protocol.codec` converts messages to bytes and back.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from protocol.signals import CHANNELS, SIGNAL_COUNT

MODES: Final = 11
"""Number of flight modes (onboard.flight.modes.FlightMode)."""
DATAGRAM_MAX_BYTES: Final = 1200
SAMPLES_PER_BATCH_MAX: Final = 8
CHUNK_DATA_MAX_BYTES: Final = 1100
CHUNK_COUNT_MAX: Final = 64
DIGEST_BYTES: Final = 16
LAYOUT_BYTES: Final = 8
NO_LAYOUT: Final = bytes(LAYOUT_BYTES)
ABSOLUTE_VALUE_MAX: Final = 1e6
"""Largest magnitude of a number in an array; a larger one is an error of the sender."""
VERSION_MAX: Final = 1_000_000
"""Of feature versions; one a second is reached after 11 days."""
APART_MAX_NS: Final = 600 * 10**9
"""The time of a batch or a pose is no further from the time at which it was sent."""
COUNTER_MAX: Final = 2**63 - 1
"""Times, indices and counters are non-negative and fit 63 bits."""


def _require(condition: bool, what: str) -> None:
    if not condition:
        raise ValueError(what)


def _require_counters(names: str, *values: int) -> None:
    if min(values) < 0 or max(values) > COUNTER_MAX:
        raise ValueError(f"{names}: negative or beyond 63 bits")


def _require_array(name: str, array: NDArray[np.floating], shape: tuple[int, ...]) -> None:
    # the texts are formatted only when needed: formatting costs as much as the checks
    if array.shape != shape:
        raise ValueError(f"{name}: shape {array.shape}, expected {shape}")
    # this form refuses NaN: the maximum of an array with a NaN is NaN, and NaN <= x is False
    if not float(np.maximum.reduce(np.abs(array), axis=None)) <= ABSOLUTE_VALUE_MAX:
        raise ValueError(f"{name}: a value is not finite or too large")


@dataclass(frozen=True, slots=True, eq=False)
class SampleBatch:
    """Up: consecutive samples of one flight. A jump of `first_index` between batches is a gap.

    Raises ValueError on construction if a field has the wrong shape or is out of range.
    """

    first_index: int
    """Index of the first sample; 0 is the first one of the onboard process."""
    time_ns: int
    """Time of the first sample; the others follow at `period_ns`."""
    period_ns: int
    feature_version: int
    """The version that was flying; 0 for the random start features."""
    signals: NDArray[np.float32]
    """[n, SIGNAL_COUNT], units in protocol.signals."""
    delivered: NDArray[np.float32]
    """[n, 2, 3]: u_hat of each channel, averaged over the period that ends at the sample; m/s^2, rad/s^2."""
    adaptive: NDArray[np.float32]
    """[n, 2, 3]: nu_ad of each channel at the sample; m/s^2, rad/s^2."""

    def __post_init__(self) -> None:
        n = self.signals.shape[0]
        _require(1 <= n <= SAMPLES_PER_BATCH_MAX, f"{n} samples, allowed 1 to {SAMPLES_PER_BATCH_MAX}")
        _require_counters("first_index, time_ns", self.first_index, self.time_ns)
        _require(0 <= self.feature_version <= VERSION_MAX, "feature_version out of range")
        _require(0 < self.period_ns <= 10**9, f"period of {self.period_ns} ns, allowed 1 to 10^9")
        _require_array("signals", self.signals, (n, SIGNAL_COUNT))
        _require_array("delivered", self.delivered, (n, len(CHANNELS), 3))
        _require_array("adaptive", self.adaptive, (n, len(CHANNELS), 3))


@dataclass(frozen=True, slots=True)
class Status:
    """Up, several times a second: flight mode, feature versions, transfer and link of onboard."""

    mode: int
    """onboard.flight.modes.FlightMode as a number."""
    feature_version: int
    """Version in use; 0 for the random start features."""
    transfer_version: int
    """Version being received; 0 for none."""
    received_chunks: bytes
    """Bitmap of the received chunks of `transfer_version`: chunk i is bit i % 8 of byte i // 8; at most 8 bytes."""
    refused_version: int
    """A version that was refused; 0 for none. Some statuses name each, the oldest first; the newest one stays."""
    refusal: int
    """The reason, as an index into REFUSALS."""
    ticks: int
    missed_ticks: int
    pose_age_ms: int
    """Age of the newest relayed pose; -1 before the first one."""
    received: int
    """Datagrams accepted from the peer since start."""
    lost: int
    """Sequence numbers of the peer that have not arrived."""
    rejected: int

    def __post_init__(self) -> None:
        _require(len(self.received_chunks) <= CHUNK_COUNT_MAX // 8, "bitmap too long")
        versions = (self.feature_version, self.transfer_version, self.refused_version)
        _require(all(0 <= version <= VERSION_MAX for version in versions), "a version is out of range")
        _require(0 <= self.mode < MODES and self.refusal >= 0, "a number is out of range")
        _require(self.refusal < len(REFUSALS), f"refusal {self.refusal} unknown")
        _require_counters("counters", self.ticks, self.missed_ticks, self.received, self.lost, self.rejected)
        _require(-1 <= self.pose_age_ms < 2**32, "pose_age_ms out of range")


REFUSALS: Final[tuple[str, ...]] = (
    "",
    "undecodable",
    "digest",
    "inputs",
    "not_finite",
    "lipschitz",
    "weight_norm",
    "swap_jump",
    "stale",
    "not_accepting",
    "misfit",
    "reach",
    "slope",
    "swap_rate",
    "probation",
    "taken_back",
    "not_trusted",
)
"""The reasons for which onboard refuses a feature version; Status holds the index."""


@dataclass(frozen=True, slots=True)
class FeatureChunk:
    """Down: one piece of an encoded feature set."""

    version: int
    index: int
    count: int
    digest: bytes
    """BLAKE2b, 16 bytes, of the whole encoded feature set."""
    data: bytes

    def __post_init__(self) -> None:
        _require(1 <= self.version <= VERSION_MAX, f"version {self.version} out of range")
        _require(1 <= self.count <= CHUNK_COUNT_MAX, f"count {self.count}, allowed 1 to {CHUNK_COUNT_MAX}")
        _require(0 <= self.index < self.count, f"index {self.index} not below count {self.count}")
        _require(len(self.digest) == DIGEST_BYTES, f"digest of {len(self.digest)} bytes")
        _require(1 <= len(self.data) <= CHUNK_DATA_MAX_BYTES, f"chunk of {len(self.data)} bytes")


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """Down: a pose of the vehicle from the motion capture, relayed by offboard."""

    time_ns: int
    """When the vehicle had this pose, in the sender's clock."""
    position_ned_m: NDArray[np.float32]
    """[3], world NED."""
    quaternion: NDArray[np.float32]
    """[4], wxyz, body FRD to world NED, unit length within 1e-3."""

    def __post_init__(self) -> None:
        if not 0 <= self.time_ns <= COUNTER_MAX:
            raise ValueError("time_ns: negative or beyond 63 bits")
        if self.position_ned_m.shape != (3,) or self.quaternion.shape != (4,):
            shapes = f"{self.position_ned_m.shape} and {self.quaternion.shape}"
            raise ValueError(f"position_ned_m and quaternion: shapes {shapes}, expected (3,) and (4,)")
        # plain numbers: checks of arrays this small are faster without numpy; NaN fails every check
        n, e, d = self.position_ned_m.tolist()
        if not (abs(n) <= ABSOLUTE_VALUE_MAX and abs(e) <= ABSOLUTE_VALUE_MAX and abs(d) <= ABSOLUTE_VALUE_MAX):
            raise ValueError("position_ned_m: a value is not finite or too large")
        if not abs(math.hypot(*self.quaternion.tolist()) - 1.0) < 1e-3:
            raise ValueError("quaternion: not of unit length")


@dataclass(frozen=True, slots=True)
class TimeSyncRequest:
    """Up, and down as a challenge: asks for the clock of the peer, which answers with a TimeSyncReply."""

    origin_ns: int
    """Clock of the asking side when it sent this. The reply repeats it: a recording of a reply is not accepted."""
    layout: bytes = NO_LAYOUT
    """Digest of the sender's `features` section and sample layout, 8 bytes. `Endpoint.encode` fills it in."""

    def __post_init__(self) -> None:
        _require_counters("origin_ns", self.origin_ns)
        _require(len(self.layout) == LAYOUT_BYTES, f"layout of {len(self.layout)} bytes")


@dataclass(frozen=True, slots=True)
class TimeSyncReply:
    """Down, and up as the answer to a challenge: offset = ((receive - origin) + (transmit - arrival)) / 2."""

    origin_ns: int
    """As in the request."""
    receive_ns: int
    """Clock of the answering side when the request arrived."""
    transmit_ns: int
    """Clock of the answering side when it sent this, not before `receive_ns`."""
    layout: bytes = NO_LAYOUT
    """As in the request, of the answering side."""

    def __post_init__(self) -> None:
        _require(len(self.layout) == LAYOUT_BYTES, f"layout of {len(self.layout)} bytes")
        _require_counters("origin_ns, receive_ns, transmit_ns", self.origin_ns, self.receive_ns, self.transmit_ns)
        _require(self.transmit_ns >= self.receive_ns, "transmit_ns before receive_ns")


Message = SampleBatch | Status | FeatureChunk | Pose | TimeSyncRequest | TimeSyncReply
