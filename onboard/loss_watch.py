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
SILENT_WINDOWS: Final = 5
"""After so many without a datagram nothing is known any more."""


class LossWatch:
    """The loss of one link, window by window."""

    def __init__(self) -> None:
        self.share = 0.0
        """Share of the datagrams lost, the smaller of the last two windows: one silence alone does not count."""
        self._last_share = 0.0
        self._silent = 0
        self._ends_ns: int | None = None
        self._received = self._lost = 0

    def step(self, statistics: LinkStatistics, now_ns: int) -> float:
        """`share`, brought up to date at the end of each window."""
        if self._ends_ns is not None and now_ns < self._ends_ns:
            return self.share
        received = statistics.received - self._received
        if self._ends_ns is not None and received > 0:
            lost = max(statistics.lost - self._lost, 0) if statistics.delay_mean_ns <= QUEUEING_NS else 0
            share = lost / (received + lost)
            self.share = min(share, self._last_share)
            self._last_share, self._silent = share, 0
        else:
            self._silent += 1
            if self._silent >= SILENT_WINDOWS:
                self.share = self._last_share = 0.0
        self._received, self._lost = statistics.received, statistics.lost
        self._ends_ns = now_ns + WINDOW_NS
        return self.share
