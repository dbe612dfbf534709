"""Estimates the share of the peer's datagrams that the radio loses at present.

The share is measured in windows in which datagrams arrived: over the whole flight would be too slow, from one gap too
fast. Datagrams dropped by a full queue do not count, because a sender that answers them by sending more makes the queue
longer. Datagrams that queue arrive late, so a mean delay beyond 50 ms is taken as a queue, also on a long path without
one. The delay from the peer is known to within half the asymmetry of the two directions; of the direction to the peer
only the byte budget is known.
"""

from typing import Final

from protocol.statistics import LinkStatistics

WINDOW_NS: Final = 1_000_000_000
QUEUEING_NS: Final = 50_000_000
"""A longer mean delay is taken as queueing."""
SILENT_NS: Final = 5_000_000_000
"""After this time without a datagram the share is unknown, and reported as 0."""


class LossRate:
    """The loss of one link, window by window."""

    def __init__(self) -> None:
        self.share = 0.0
        """Share of the datagrams lost, the smaller of the last two windows: one silence alone does not count."""
        self._last_share = 0.0
        self._ends_ns = 0
        self._received = self._lost = 0

    def step(self, statistics: LinkStatistics, now_ns: int) -> float:
        """Returns `share`, updated at the end of each window."""
        if now_ns < self._ends_ns:
            return self.share
        received = statistics.received - self._received
        if received > 0:
            lost = max(statistics.lost - self._lost, 0) if statistics.delay_mean_ns <= QUEUEING_NS else 0
            share = lost / (received + lost)
            self.share = min(share, self._last_share)
            self._last_share = share
        elif (statistics.age_ns(now_ns) or 0) >= SILENT_NS:
            self.share = self._last_share = 0.0
        self._received, self._lost = statistics.received, statistics.lost
        self._ends_ns = now_ns + WINDOW_NS
        return self.share
