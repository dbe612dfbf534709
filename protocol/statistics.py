"""What an endpoint has seen of its link: counts, gaps and ages. The lockstep and the real link fill the same record."""

from collections import Counter
from dataclasses import dataclass, field


@dataclass(slots=True)
class LinkStatistics:
    """Running figures of one endpoint; `received` and what follows concern datagrams from the peer."""

    sent: int = 0
    sent_bytes: int = 0
    received: int = 0
    """Genuine, fresh datagrams (a body that did not decode included: the link did bring it)."""
    received_bytes: int = 0
    lost: int = 0
    """Sequence numbers between the first and the newest of each session that have not come (yet)."""
    duplicate: int = 0
    """Datagrams that had come before: duplicated on the way, or replayed."""
    reordered: int = 0
    """Datagrams received after one that was sent later."""
    sessions: int = 0
    """Sessions of the peer that were accepted; more than one means that it restarted."""
    rejected: Counter[str] = field(default_factory=Counter)
    """By reason: length, version, type, vehicle, mac, session, too_old, sequence, rate, body, value, time_sync."""
    last_received_ns: int | None = None
    longest_gap_ns: int = 0
    """Longest time between two received datagrams."""
    delay_ns: int = 0
    """Delay of the newest datagram: absolute where the clock offset is known, else above the session's fastest."""
    delay_mean_ns: float = 0.0
    """Exponential mean of `delay_ns` over about 32 datagrams."""
    delay_max_ns: int = 0

    def count_received(self, size_bytes: int, delay_ns: int, now_ns: int) -> None:
        """Counts one accepted datagram."""
        if self.last_received_ns is not None:
            self.longest_gap_ns = max(self.longest_gap_ns, now_ns - self.last_received_ns)
        self.last_received_ns = now_ns
        self.received += 1
        self.received_bytes += size_bytes
        self.delay_ns = delay_ns
        self.delay_mean_ns += (delay_ns - self.delay_mean_ns) / min(self.received, 32)
        self.delay_max_ns = max(self.delay_max_ns, delay_ns)

    @property
    def rejected_total(self) -> int:
        """Rejected datagrams of all reasons."""
        return self.rejected.total()

    @property
    def loss_fraction(self) -> float:
        """Lost share of what the peer sent, 0 when nothing is known yet."""
        expected = self.received + self.lost
        return self.lost / expected if expected else 0.0

    def age_ns(self, now_ns: int) -> int | None:
        """Time since the peer was heard; None when it never was."""
        return None if self.last_received_ns is None else now_ns - self.last_received_ns
