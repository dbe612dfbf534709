"""Maps the clock of a sender to ours: the offset is the least (arrival - stamp) of the last two seconds.

The least delay is the one without queueing. A window, instead of a minimum that grows slowly, forgets a wrong minimum
after two seconds, and an error of the clocks' rates of 100 ppm costs at most 0.2 ms. The second least delay counts, so
one early datagram changes nothing.
"""

import math
from collections import deque
from typing import Final

WINDOW_NS: Final = 2_000_000_000
"""No delay counts longer than this."""
BUCKET_NS: Final = WINDOW_NS // 8
AHEAD_NS: Final = 20_000_000
"""A stamp that is earlier than the least delay allows by more than this is ahead of its cause."""


class ClockMap:
    """The offset, our clock minus the sender's clock, ns, from the delays of the datagrams."""

    __slots__ = ("_bucket", "_current", "_sealed", "_window", "known", "offset_ns")

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget all delays; the next one starts a new mapping."""
        self._bucket = -(2**62)
        self._current: tuple[float, float] = (math.inf, math.inf)
        self._sealed: deque[tuple[int, tuple[float, float]]] = deque()
        self._window: tuple[float, float] = (math.inf, math.inf)
        self.known = False
        """Whether there is a mapping."""
        self.offset_ns = 0
        """Valid if `known`."""

    def is_ahead(self, delay_ns: int) -> bool:
        """Whether a delay is too small for the mapping: the stamp is wrong, or the clock has jumped forwards."""
        return self.known and delay_ns < self.offset_ns - AHEAD_NS

    def add(self, delay_ns: int, arrival_ns: int) -> None:
        """Add the delay of a datagram (arrival - stamp) that arrived at `arrival_ns`."""
        bucket = arrival_ns // BUCKET_NS
        if bucket > self._bucket:
            self._turn(bucket)
        least, second = self._current
        if delay_ns < second:
            least, second = (delay_ns, least) if delay_ns < least else (least, delay_ns)
            self._current = least, second
        before, second_before = self._window
        if before < least:
            least, second = before, min(second_before, least)
        else:
            second = min(before, second)
        self.offset_ns = int(least if second == math.inf else second)
        self.known = True

    def to_ours(self, stamp_ns: int, arrival_ns: int) -> int:
        """Our time of a stamp that arrived at `arrival_ns`: never after its arrival."""
        return min(stamp_ns + self.offset_ns, arrival_ns)

    def _turn(self, bucket: int) -> None:
        """Begin a new bucket, and forget those that have left the window."""
        self._sealed.append((self._bucket, self._current))
        self._bucket, self._current = bucket, (math.inf, math.inf)
        oldest = bucket - WINDOW_NS // BUCKET_NS
        while self._sealed and self._sealed[0][0] <= oldest:
            self._sealed.popleft()
        self._window = _two_least(*(delay for _, pair in self._sealed for delay in pair))


def _two_least(*delays: float) -> tuple[float, float]:
    least, second, *_ = (*sorted(delays), math.inf, math.inf)
    return least, second
