"""Statistics of a link: counts, gaps, delays and ages."""

from collections import Counter
from dataclasses import dataclass, field
from typing import Final

REJECTIONS: Final[tuple[str, ...]] = (
    "",
    "length",
    "version",
    "type",
    "vehicle",
    "mac",
    "session",
    "duplicate",
    "too_old",
    "sequence",
    "rate",
    "body",
    "value",
    "layout",
    "before_start",
    "time_sync",
    "not_alive",
)
"""Why a datagram may be rejected, in the order of the checks (docs/protocol.md). not_alive: onboard's own check."""


@dataclass(slots=True)
class LinkStatistics:
    """Statistics of one endpoint since start. `received` and all fields below it concern datagrams from the peer."""

    sent: int = 0
    sent_bytes: int = 0
    received: int = 0
    """Genuine, new datagrams, including those whose body did not decode."""
    received_bytes: int = 0
    lost: int = 0
    """Sequence numbers between the first and the newest of each session that have not arrived (yet)."""
    duplicate: int = 0
    """Datagrams that had arrived before: duplicated on the way, or replayed."""
    reordered: int = 0
    """Datagrams received after one that was sent later."""
    sessions: int = 0
    """Sessions of the peer that were accepted; more than one means that it restarted."""
    rejected: Counter[str] = field(default_factory=Counter)
    """By reason, of REJECTIONS; duplicates are counted in `duplicate`."""
    last_received_ns: int | None = None
    longest_gap_ns: int = 0
    """Longest time between two received datagrams."""
    delay_ns: int = 0
    """Delay of the newest datagram: absolute if the clock offset is known, else above the fastest of the session."""
    delay_mean_ns: float = 0.0
    """Exponential mean of `delay_ns` over about 32 datagrams."""
    delay_max_ns: int = 0

    def count_received(self, size_bytes: int, delay_ns: int, now_ns: int) -> None:
        """Count one accepted datagram."""
        if self.last_received_ns is not None:
            self.longest_gap_ns = max(self.longest_gap_ns, now_ns - self.last_received_ns)
        self.last_received_ns = now_ns
        self.received += 1
        self.received_bytes += size_bytes
        self.delay_ns = delay_ns
        self.delay_mean_ns += (delay_ns - self.delay_mean_ns) / min(self.received, 32)
        self.delay_max_ns = max(self.delay_max_ns, delay_ns)

    @property
    def loss_fraction(self) -> float:
        """Lost share of the datagrams that the peer sent; 0 before the first one."""
        expected = self.received + self.lost
        return self.lost / expected if expected else 0.0

    def age_ns(self, now_ns: int) -> int | None:
        """Time since the last datagram of the peer; None before the first one."""
        return None if self.last_received_ns is None else now_ns - self.last_received_ns
