"""How much of what the peer sends gets lost on the air at present.

Over the whole flight would be too slow, one gap too quick: it is told by windows in which something came. What a full
queue drops does not count, since whoever answers that by sending more makes it worse. Where datagrams queue they come
late, so a mean delay beyond 50 ms is taken for a queue, that of a long path without one as well. How long the way down
takes is known to half of what the two ways differ; of the way up nothing is known but the byte budget.
"""

from typing import Final

from protocol.statistics import LinkStatistics

WINDOW_NS: Final = 1_000_000_000
QUEUEING_NS: Final = 50_000_000
"""A mean delay beyond this is taken for a queue's."""
SILENT_NS: Final = 5_000_000_000
"""After so long without a datagram nothing is known any more."""


class LossRate:
    """The loss of one link, window by window."""

    def __init__(self) -> None:
        self.share = 0.0
        """Share of the datagrams lost, the smaller of the last two windows: one silence alone does not count."""
        self._last_share = 0.0
        self._ends_ns = 0
        self._received = self._lost = 0

    def step(self, statistics: LinkStatistics, now_ns: int) -> float:
        """`share`, brought up to date at the end of each window."""
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
