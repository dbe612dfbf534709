"""Watches processes from outside: their memory, and how long they waited for a processor."""

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from runtime.kernel import resident_mb

MEMORY_EVERY_S: Final = 2.0
WARM_UP_S: Final = 60.0
"""Memory of a process that is younger than this is left out of the slope."""
SLOPE_OVER_MIN_S: Final = 90.0
"""A slope over a shorter time is none: single steps decide it."""
_HZ: Final = os.sysconf("SC_CLK_TCK")


@dataclass(slots=True)
class Life:
    """One run of a process."""

    name: str
    number: int
    """Process id."""
    times_s: list[float] = field(default_factory=list)
    """Monotonic clock."""
    memory_mb: list[float] = field(default_factory=list)

    def note(self, now_s: float) -> None:
        """Store the memory now; nothing if the process has ended."""
        try:
            memory = resident_mb(self.number)
        except OSError:
            return
        if memory > 0.0:  # 0: it has ended, and its parent has not noticed yet
            self.times_s.append(now_s)
            self.memory_mb.append(memory)

    @property
    def seconds(self) -> float:
        """Time from the first to the last sample."""
        return self.times_s[-1] - self.times_s[0] if self.times_s else 0.0

    def slope_mb_min(self) -> float:
        """Slope of the memory, MB/min (Theil-Sen, so that single steps do not decide); NaN for a short life."""
        from scipy.stats import theilslopes

        if self.seconds < WARM_UP_S + SLOPE_OVER_MIN_S:
            return float("nan")
        times = np.array(self.times_s)
        late = times - times[0] >= WARM_UP_S
        return 60.0 * float(theilslopes(np.array(self.memory_mb)[late], times[late])[0])


class Waits:
    """How long the threads of a process waited for a processor, and how long the host took the processors away."""

    def __init__(self, process: int) -> None:
        self._tasks = Path(f"/proc/{process}/task")
        self._times_ns: list[int] = []
        self._waited_ns: list[int] = []

    def note(self, now_ns: int) -> None:
        """Store both now; nothing if the process has ended or the kernel does not count."""
        try:
            waits = [int((task / "schedstat").read_text().split()[1]) for task in self._tasks.iterdir()]
            stolen = int(Path("/proc/stat").read_text(encoding="ascii").split("\n", 1)[0].split()[8])
        except (OSError, IndexError):
            return
        self._times_ns.append(now_ns)
        self._waited_ns.append(sum(waits) + stolen * 10**9 // _HZ)

    def between(self, begin_ns: NDArray[np.int64], end_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Time waited in each span, widened to the samples around it, ns."""
        if len(self._times_ns) < 2:
            return np.zeros(len(begin_ns), dtype=np.int64)
        times, waited = np.array(self._times_ns), np.array(self._waited_ns)
        before = np.clip(np.searchsorted(times, begin_ns, side="right") - 1, 0, len(times) - 1)
        after = np.clip(np.searchsorted(times, end_ns), 0, len(times) - 1)
        found: NDArray[np.int64] = waited[after] - waited[before]
        return found
