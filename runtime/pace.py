"""The pace keeper of the 200 Hz loop: absolute deadlines, missed ticks skipped and counted, and its statistics.

Theory of operation. Every deadline is start + k * period on the monotonic clock, so that being late once moves no
later tick (setting the next tick from the moment of waking gives 177 to 182 Hz instead of 200). After a stall the
deadlines that have wholly passed are skipped: running them back to back would feed the controller stale inputs
with wrong time steps. What the kernel grants (timer slack, priority) decides how punctual the sleep is; a short
busy wait before the deadline buys the rest.
"""

import time
from collections.abc import Callable
from typing import Final

HISTOGRAM_LIMIT_US: Final = 20_000


class PaceKeeper:
    """Wakes at absolute deadlines.

    Parameters
    ----------
    period_ns: distance of the deadlines.
    spin_ns: busy wait before each deadline; 0 sleeps all the way.
    start_ns: the first deadline, in the clock's time.
    clock, sleep: the world's, or a test's.
    """

    __slots__ = ("_clock", "_deadline_ns", "_period_ns", "_sleep", "_spin_ns", "lateness_ns", "missed", "ticks")

    def __init__(
        self,
        period_ns: int,
        spin_ns: int,
        start_ns: int,
        clock: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._period_ns = period_ns
        self._spin_ns = spin_ns
        self._deadline_ns = start_ns
        self._clock = clock
        self._sleep = sleep
        self.ticks = 0
        self.missed = 0
        """Deadlines that had wholly passed when the loop came back, and were skipped."""
        self.lateness_ns = 0
        """How late the latest wake-up was."""

    def wait(self) -> int:
        """Wait for the next deadline that has not wholly passed; returns the time of waking, ns."""
        clock = self._clock
        now = clock()
        skipped = (now - self._deadline_ns) // self._period_ns
        if skipped > 0:
            self.missed += skipped
            self._deadline_ns += skipped * self._period_ns
        deadline = self._deadline_ns
        ahead_ns = deadline - now - self._spin_ns
        if ahead_ns > 0:
            self._sleep(ahead_ns * 1e-9)
            now = clock()
        while now < deadline:
            now = clock()
        self.lateness_ns = now - deadline
        self._deadline_ns = deadline + self._period_ns
        self.ticks += 1
        return now


class DurationStatistics:
    """Durations counted in bins of 1 us, exact quantiles up to 20 ms, at constant memory."""

    __slots__ = ("_counts", "_maximum_ns", "_total")

    def __init__(self) -> None:
        self._counts = [0] * (HISTOGRAM_LIMIT_US + 1)
        self._maximum_ns = 0
        self._total = 0

    def add(self, duration_ns: int) -> None:
        """Count one duration."""
        self._counts[min(duration_ns // 1000, HISTOGRAM_LIMIT_US)] += 1
        self._total += 1
        if duration_ns > self._maximum_ns:
            self._maximum_ns = duration_ns

    def quantile_us(self, fraction: float) -> float:
        """The smallest whole number of microseconds that at least `fraction` of the durations stay below."""
        wanted, seen = fraction * self._total, 0
        for microseconds, count in enumerate(self._counts):
            seen += count
            if seen >= wanted and seen > 0:
                return float(microseconds + 1)
        return 0.0

    def summary(self) -> dict[str, float]:
        """p50, p99 and max in us."""
        return {
            "p50": self.quantile_us(0.5),
            "p99": self.quantile_us(0.99),
            "max": round(self._maximum_ns / 1000, 1),
        }
