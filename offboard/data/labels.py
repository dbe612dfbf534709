"""Labels: what the uncertainty Delta was at each sample, looked at from both sides in time.

Theory of operation. The plant of a channel is v_dot = u_hat + Delta, where v is the velocity (position channel)
or the body rates (attitude channel). Onboard averages u_hat over the period that ends at a sample, and the
difference of v over the same period is the mean of v_dot over it, so that

    r_i = (v_i - v_(i-1)) / T - u_hat_i

is the mean of Delta over that period, up to noise: exactly, whatever u_hat did. r_i belongs to the period's middle,
t_i - T/2. The label of sample i is the value at t_i of a polynomial fitted by least squares to the r_j around it
(Savitzky-Golay, an even window that is centred on t_i): non-causal, which a trainer can afford.

A window never reaches across a gap: at the ends of a gapless run it is cut, down to where its value at t_i would be
too noisy, and there is no label then.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from offboard.config import LabelConfig
from protocol.conventions import Array
from protocol.messages import SAMPLES_PER_BATCH_MAX, SampleBatch
from protocol.signals import CHANNELS, SIGNAL_COUNT, SIGNAL_INDEX

RING: Final = 512
"""Samples remembered for smoothing: 10 s at 50 Hz, far more than any window and wait."""
NOISE_GAIN_LIMIT: Final = 3.0
"""A cut window may be so many times noisier (in variance) than a whole one."""
PERIOD_TOLERANCE: Final = 0.25
"""Two neighbours farther from one period apart than this share of it are not neighbours."""
VELOCITY: Final = np.array(
    [
        [SIGNAL_INDEX[f"velocity_{axis}"] for axis in "ned"],
        [SIGNAL_INDEX[f"rate_{axis}"] for axis in "pqr"],
    ]
)
"""[channel, axis]: the signal whose derivative u and Delta act on."""
_HEIGHT: Final = SIGNAL_INDEX["position_d"]


@dataclass(frozen=True, slots=True, eq=False)
class LabelledSample:
    """A sample and the uncertainty that acted there."""

    index: int
    time_ns: int
    signals: Array
    """[SIGNAL_COUNT]"""
    labels: Array
    """[2, 3]: Delta of each channel, m/s^2 and rad/s^2."""


@lru_cache(maxsize=4096)
def smoothing_weights(left: int, right: int, order: int) -> tuple[Array, float]:
    """Weights c with Delta(t_i) = sum c_j r_j over r_(i-left+1) .. r_(i+right), and the gain sum c_j^2 of their noise.

    r_j stands at t_j - T/2, so in periods the points lie at -left + 1/2 .. right - 1/2 and the fit is read at 0.
    """
    at = np.arange(-left, right) + 0.5
    V = np.vander(at, min(order, left + right - 1) + 1, increasing=True)
    c = np.linalg.pinv(V)[0]
    return c, float(c @ c)


class LabelMaker:
    """Puts samples in order and turns them into labelled ones as soon as enough of their future is known."""

    def __init__(self, config: LabelConfig) -> None:
        self._config = config
        self._limits = np.array([[config.position_limit_m_s2], [config.attitude_limit_rad_s2]])
        self._windows_s = (config.position_window_s, config.attitude_window_s)
        self._signals = np.zeros((RING, SIGNAL_COUNT))
        self._delivered = np.zeros((RING, len(CHANNELS), 3))
        self._adaptive = np.zeros((RING, len(CHANNELS), 3))
        self._residual = np.zeros((RING, len(CHANNELS), 3))
        self._time_ns = np.zeros(RING, dtype=np.int64)
        self._index = np.full(RING, -1, dtype=np.int64)
        self._residual_of = np.full(RING, -1, dtype=np.int64)
        self.samples = 0
        self.labels = 0
        self.restart()

    def restart(self) -> None:
        """Forget all samples: a new flight begins, whose indices have nothing to do with the old ones."""
        self._index[:] = -1
        self._residual_of[:] = -1
        self._next = -1
        self._newest = -1
        self._period_ns = 0

    def receive(self, batch: SampleBatch) -> list[LabelledSample]:
        """Store the samples of a batch and give out the labelled samples that became ready, oldest first."""
        if batch.period_ns != self._period_ns:
            self.restart()
            self._period_ns = batch.period_ns
        first, n = batch.first_index, batch.signals.shape[0]
        if self._newest >= 0 and first + n - 1 <= self._newest - RING // 2:
            return []
        if self._newest < 0:
            self._next = max(0, first - SAMPLES_PER_BATCH_MAX)  # the batch before may still be on its way
        for offset in range(n):
            self._store(batch, offset)
        self._newest = max(self._newest, first + n - 1)
        self._next = max(self._next, self._newest - RING // 2)
        for index in range(first, first + n + 1):
            self._make_residual(index)
        return self._ready()

    def _store(self, batch: SampleBatch, offset: int) -> None:
        index = batch.first_index + offset
        slot = index % RING
        on_ground = -batch.signals[offset, _HEIGHT] < self._config.minimum_height_m
        if on_ground or self._index[slot] >= index:
            return
        self._index[slot] = index
        self._time_ns[slot] = batch.time_ns + offset * batch.period_ns
        self._signals[slot] = batch.signals[offset]
        self._delivered[slot] = batch.delivered[offset]
        self._adaptive[slot] = batch.adaptive[offset]
        self.samples += 1

    def _make_residual(self, index: int) -> None:
        """r_i, if sample i and its left neighbour are both there."""
        slot, before = index % RING, (index - 1) % RING
        if self._index[slot] != index or self._index[before] != index - 1 or self._residual_of[slot] == index:
            return
        elapsed_ns = int(self._time_ns[slot] - self._time_ns[before])
        if abs(elapsed_ns - self._period_ns) > PERIOD_TOLERANCE * self._period_ns:
            return
        difference = self._signals[slot][VELOCITY] - self._signals[before][VELOCITY]
        self._residual[slot] = difference * (1e9 / elapsed_ns) - self._delivered[slot]
        self._residual_of[slot] = index

    def _ready(self) -> list[LabelledSample]:
        halves = [self._half_window(window_s) for window_s in self._windows_s]
        reach = max(halves)
        wait = reach + int(self._config.reorder_s * 1e9 / self._period_ns)
        ready: list[LabelledSample] = []
        while self._next <= self._newest:
            index = self._next
            right = self._run_right(index, reach)
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

    def _run_right(self, index: int, reach: int) -> int:
        """How many of r_(index+1), r_(index+2), ... are there without a gap, up to `reach`."""
        for count in range(reach):
            if self._residual_of[(index + 1 + count) % RING] != index + 1 + count:
                return count
        return reach

    def _run_left(self, index: int, reach: int) -> int:
        """How many of r_index, r_(index-1), ... are there without a gap, up to `reach`."""
        for count in range(reach):
            if self._residual_of[(index - count) % RING] != index - count:
                return count
        return reach

    def _label(self, index: int, halves: list[int], right: int) -> LabelledSample | None:
        slot = index % RING
        if self._index[slot] != index:
            return None
        if self._config.kind == "mrgen":
            labels = self._adaptive[slot].copy()
        else:
            left = self._run_left(index, max(halves))
            rows = [self._smooth(index, channel, half, left, right) for channel, half in enumerate(halves)]
            if any(row is None for row in rows):
                return None
            labels = np.array(rows)
        if (np.abs(labels) > self._limits).any():
            return None
        return LabelledSample(index, int(self._time_ns[slot]), self._signals[slot].copy(), labels)

    def _smooth(self, index: int, channel: int, half: int, left: int, right: int) -> Array | None:
        """Delta of one channel at sample `index`, or None where the window is cut too short. [3]"""
        left, right = min(left, half), min(right, half)
        if left + right < half:
            return None
        order = self._config.order
        c, gain = smoothing_weights(left, right, order)
        if gain > NOISE_GAIN_LIMIT * smoothing_weights(half, half, order)[1]:
            return None
        slots = np.arange(index - left + 1, index + right + 1) % RING
        smooth: Array = c @ self._residual[slots, channel]
        return smooth
