"""Labels: the uncertainty Delta at each sample, estimated from the samples before and after it.

Theory of operation. The plant of a channel is v_dot = u_hat + Delta, where v is the velocity (position channel)
or the body rates (attitude channel). Onboard averages u_hat over the period that ends at a sample. The difference of
v over the same period is the mean of v_dot over it, so that

    r_i = (v_i - v_(i-1)) / T - u_hat_i

is the mean of Delta over that period, plus sensor noise, for any course of u_hat. r_i belongs to the middle of the
period, t_i - T/2. The label of sample i is the value at t_i of a polynomial fitted by least squares to the r_j around
it (Savitzky-Golay, with an even window centred on t_i):

    Delta_i = sum_j c_j r_j,  j = i - left + 1 ... i + right

This is not causal: a label is ready once the samples after it have arrived. A window never spans a gap. At the ends of
a run without gaps it is cut; where the cut makes Delta_i too noisy, the channel gets no label. Each channel is labelled
on its own: one that has no label at a sample does not cost the other its label. Every sample and label that is not used
is counted, with the reason.
"""

from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from offboard.config import LabelConfig
from protocol.conventions import Array
from protocol.messages import SAMPLES_PER_BATCH_MAX, SampleBatch
from protocol.signals import CHANNELS, SIGNAL_COUNT, SIGNAL_INDEX

RING: Final = 512
"""Samples stored for smoothing: 10 s at 50 Hz, far more than the longest window and wait."""
NOISE_GAIN_LIMIT: Final = 3.0
"""Largest ratio of the noise variance of a cut window to that of a full one."""
PERIOD_TOLERANCE: Final = 0.25
"""Two samples are neighbours if their distance differs from one period by at most this share of it."""
VELOCITY: Final = np.array(
    [
        [SIGNAL_INDEX[f"velocity_{axis}"] for axis in "ned"],
        [SIGNAL_INDEX[f"rate_{axis}"] for axis in "pqr"],
    ]
)
"""[channel, axis]: index of v, the signal on whose derivative u and Delta act."""
_HEIGHT: Final = SIGNAL_INDEX["position_d"]
UNUSED: Final = ("low", "late", *(f"{reason}_{name}" for reason in ("gap", "over_limit") for name in CHANNELS))
"""Why data are not used. Samples: low (below the minimum height), late (arrived after labels of much later samples).
Labels of a channel: gap (too few neighbours without a gap), over_limit (larger than the limit)."""


@dataclass(frozen=True, slots=True, eq=False)
class LabelledSample:
    """A sample with its labels."""

    index: int
    time_ns: int
    signals: Array
    """[SIGNAL_COUNT]"""
    labels: Array
    """[2, 3]: Delta of each channel, m/s^2 and rad/s^2; NaN where the channel has no label."""
    condition: int = 0
    """The condition in which it was flown: samples of two conditions may have different labels at the same place."""


@lru_cache(maxsize=4096)
def smoothing_weights(left: int, right: int, order: int) -> tuple[Array, float]:
    """Weights c_j of r_(i-left+1) ... r_(i+right) in Delta_i, [left + right], and their noise gain sum_j c_j^2.

    With t_i as the origin and T as the unit of time, r_j is at -left + 1/2 ... right - 1/2. The fit is evaluated at 0.
    """
    at = np.arange(-left, right) + 0.5
    V = np.vander(at, min(order, left + right - 1) + 1, increasing=True)
    c = np.linalg.pinv(V)[0]
    return c, float(c @ c)


class LabelMaker:
    """Sorts samples and labels each one as soon as enough samples after it have arrived.

    Parameters
    ----------
    channels: names of the channels that are learnt; the others get no labels.
    """

    def __init__(self, config: LabelConfig, channels: Collection[str] = CHANNELS) -> None:
        self._config = config
        self._learnt = [at for at, name in enumerate(CHANNELS) if name in channels]
        self._limits = (config.position_limit_m_s2, config.attitude_limit_rad_s2)
        self._windows_s = (config.position_window_s, config.attitude_window_s)
        self._signals = np.zeros((RING, SIGNAL_COUNT))
        self._delivered = np.zeros((RING, len(CHANNELS), 3))
        self._adaptive = np.zeros((RING, len(CHANNELS), 3))
        self._r = np.zeros((RING, len(CHANNELS), 3))
        self._time_ns = np.zeros(RING, dtype=np.int64)
        self._index = np.full(RING, -1, dtype=np.int64)
        self._residual_of = np.full(RING, -1, dtype=np.int64)
        self.samples = 0
        self.labels = 0
        """Samples with a label in at least one channel."""
        self.unused: Final = Counter(dict.fromkeys(UNUSED, 0))
        """Samples and labels that were not used, by reason (UNUSED)."""
        self._next = self._newest = -1
        self.restart()

    def restart(self) -> None:
        """Discard all samples: a new flight starts, with its own sample indices."""
        self._count_waiting(self._newest + 1)
        self._index[:] = -1
        self._residual_of[:] = -1
        self._next = -1
        self._newest = -1
        self._period_ns = 0

    def receive(self, batch: SampleBatch) -> list[LabelledSample]:
        """Store the samples of a batch; returns the samples whose labels are now ready, oldest first."""
        if batch.period_ns != self._period_ns:
            self.restart()
            self._period_ns = batch.period_ns
        first, n = batch.first_index, batch.signals.shape[0]
        if self._newest >= 0 and first + n - 1 <= self._newest - RING // 2:
            self.unused["late"] += n
            return []
        if self._newest < 0:
            self._next = max(0, first - SAMPLES_PER_BATCH_MAX)  # the batch before this one may arrive later
        newest = max(self._newest, first + n - 1)
        self._count_waiting(newest - RING // 2)
        for offset in range(n):
            self._store(batch, offset)
        self._newest = newest
        self._next = max(self._next, newest - RING // 2)
        for index in range(first, first + n + 1):
            self._make_residual(index)
        return self._ready()

    def _count_waiting(self, until: int) -> None:
        """Count the samples that wait for a label and are below this index: they will not get one."""
        waiting = (self._index >= max(self._next, 0)) & (self._index < until)
        for channel in self._learnt:
            self.unused[f"gap_{CHANNELS[channel]}"] += int(waiting.sum())

    def _store(self, batch: SampleBatch, offset: int) -> None:
        index = batch.first_index + offset
        slot = index % RING
        if self._index[slot] >= index:
            return
        if -batch.signals[offset, _HEIGHT] < self._config.minimum_height_m:
            self.unused["low"] += 1
            return
        self._index[slot] = index
        self._time_ns[slot] = batch.time_ns + offset * batch.period_ns
        self._signals[slot] = batch.signals[offset]
        self._delivered[slot] = batch.delivered[offset]
        self._adaptive[slot] = batch.adaptive[offset]
        self.samples += 1

    def _make_residual(self, index: int) -> None:
        """r_i = (v_i - v_(i-1)) / T - u_hat_i, if sample i and the one before it are stored."""
        slot, before = index % RING, (index - 1) % RING
        if self._index[slot] != index or self._index[before] != index - 1 or self._residual_of[slot] == index:
            return
        elapsed_ns = int(self._time_ns[slot] - self._time_ns[before])
        if abs(elapsed_ns - self._period_ns) > PERIOD_TOLERANCE * self._period_ns:
            return
        v_i, v_before, u_hat_i = self._signals[slot][VELOCITY], self._signals[before][VELOCITY], self._delivered[slot]
        self._r[slot] = (v_i - v_before) * (1e9 / elapsed_ns) - u_hat_i
        self._residual_of[slot] = index

    def _ready(self) -> list[LabelledSample]:
        halves = [self._half_window(window_s) for window_s in self._windows_s]
        reach = max(halves)
        wait = reach + int(self._config.reorder_s * 1e9 / self._period_ns)
        ready: list[LabelledSample] = []
        while self._next <= self._newest:
            index = self._next
            right = self._run(index + 1, 1, reach)
            if right < reach and self._newest < index + wait:
                break
            labelled = self._label(index, halves, right)
            if labelled is not None:
                ready.append(labelled)
            self._next += 1
        self.labels += len(ready)
        return ready

    def _half_window(self, window_s: float) -> int:
        return max(1, round(window_s * 1e9 / (2 * self._period_ns)))

    def _run(self, first: int, step: int, reach: int) -> int:
        """Number of r_first, r_(first + step), r_(first + 2 step), ... known without a gap, at most `reach`."""
        for count in range(reach):
            index = first + step * count
            if self._residual_of[index % RING] != index:
                return count
        return reach

    def _label(self, index: int, halves: list[int], right: int) -> LabelledSample | None:
        """The sample with its labels; None if it is not stored, or no channel has a label."""
        slot = index % RING
        if self._index[slot] != index:
            return None
        labels = np.full((len(CHANNELS), 3), np.nan)
        left = self._run(index, -1, max(halves)) if self._config.kind == "residual" else 0
        for channel in self._learnt:
            if self._config.kind == "mrgen":
                Delta: Array | None = self._adaptive[slot, channel]
            else:
                Delta = self._smooth(index, channel, halves[channel], left, right)
            if Delta is None:
                self.unused[f"gap_{CHANNELS[channel]}"] += 1
            elif (np.abs(Delta) > self._limits[channel]).any():
                self.unused[f"over_limit_{CHANNELS[channel]}"] += 1
            else:
                labels[channel] = Delta
        if np.isnan(labels).all():
            return None
        return LabelledSample(index, int(self._time_ns[slot]), self._signals[slot].copy(), labels)

    def _smooth(self, index: int, channel: int, half: int, left: int, right: int) -> Array | None:
        """Delta_i of one channel, [3]; None where a gap cuts the window too short."""
        left, right = min(left, half), min(right, half)
        if left + right < half:
            return None
        order = self._config.order
        c, gain = smoothing_weights(left, right, order)
        if gain > NOISE_GAIN_LIMIT * smoothing_weights(half, half, order)[1]:
            return None
        slots = np.arange(index - left + 1, index + right + 1) % RING
        Delta: Array = c @ self._r[slots, channel]
        return Delta
