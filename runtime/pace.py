"""The pace of the 200 Hz loop: absolute deadlines, missed ticks skipped and counted, and statistics of durations.

Theory of operation. Every deadline is start + k * period on the monotonic clock, so that a late tick does not delay
the next one (computing the next deadline from the time of waking gives 177 to 182 Hz instead of 200). After a stall
the deadlines that lie more than one period back are skipped, whether the loop was asleep or at work: running those
ticks back to back would give the controller outdated inputs and wrong time steps. The tick after the stall knows how
many there were (`skipped`). The lateness of the sleep depends on the kernel's settings (timer
slack, priority); a short busy wait before the deadline reduces it further.
"""

import time
from collections.abc import Callable
from typing import Final

HISTOGRAM_LIMIT_US: Final = 20_000


class PaceKeeper:
    """Wakes at absolute deadlines.

    Parameters
    ----------
    period_ns: time between deadlines.
    spin_ns: duration of the busy wait before each deadline; 0 for none.
    start_ns: the first deadline, in the clock's time.
    clock, sleep: those of the system, or of a test.
    """

    __slots__ = (
        *("_clock", "_deadline_ns", "_period_ns", "_sleep", "_spin_ns"),
        *("lateness_ns", "missed", "skipped", "ticks"),
    )

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
        """Deadlines skipped because the next one had passed too."""
        self.skipped = 0
        """How many of them right before the latest wake-up."""
        self.lateness_ns = 0
        """Lateness of the latest wake-up, against the last deadline before it."""

    def wait(self) -> int:
        """Wait for the next deadline, skipping missed ones; returns the time of waking, ns."""
        clock = self._clock
        now = clock()
        deadline = self._deadline_ns
        ahead_ns = deadline - now - self._spin_ns
        if ahead_ns > 0:
            self._sleep(ahead_ns * 1e-9)
            now = clock()
        while now < deadline:
            now = clock()
        self.skipped = (now - deadline) // self._period_ns
        self.missed += self.skipped
        deadline += self.skipped * self._period_ns
        self.lateness_ns = now - deadline
        self._deadline_ns = deadline + self._period_ns
        self.ticks += 1
        return now


class DurationStatistics:
    """Statistics of durations: a histogram with bins of 1 us up to 20 ms, in constant memory."""

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
        """The smallest whole number of microseconds that at least `fraction` of the durations are below; 0 for none."""
        wanted, seen = fraction * self._total, 0
        for microseconds, count in enumerate(self._counts):
            seen += count
            if seen >= wanted and seen > 0:
                return float(microseconds + 1)
        return 0.0

    def summary(self) -> dict[str, float]:
        """p50, p99 and max, us."""
        return {"p50": self.quantile_us(0.5), "p99": self.quantile_us(0.99), "max": round(self._maximum_ns / 1000, 1)}
