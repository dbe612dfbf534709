"""Makes sample batches for offboard from 200 Hz ticks, within a byte budget.

Samples are taken at `rate_hz`, on a grid that starts with the first tick. A sample holds the mean of u_hat
("delivered") over the ticks of its period, and the signals and nu_ad of its own tick. Its index is its place on the
grid, so a missed tick or a dropped sample shows as a jump of the index. If the budget does not suffice, the newest
samples are kept. If budget remains and the link loses many datagrams, each batch is sent a second time, a short time
later.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from configs.loader import ConfigRecord
from protocol.conventions import Array
from protocol.messages import SAMPLES_PER_BATCH_MAX, SampleBatch
from protocol.signals import CHANNELS, SIGNAL_COUNT

SAMPLE_BYTES: Final = 4 * (SIGNAL_COUNT + 2 * len(CHANNELS) * 3)
NETWORK_BYTES: Final = 28
"""UDP's and IPv4's own."""
BATCH_OVERHEAD_BYTES: Final = 88 + NETWORK_BYTES
"""Header, MAC, msgpack framing and numbers of a batch at most, and the network's."""
_BURST_BYTES: Final = 2.0 * (BATCH_OVERHEAD_BYTES + SAMPLES_PER_BATCH_MAX * SAMPLE_BYTES)


class SamplerConfig(ConfigRecord):
    """How samples are taken and sent."""

    rate_hz: float = Field(default=50.0, gt=0.0, le=200.0, description="Hz, samples a second")
    batch_samples: int = Field(default=5, ge=1, le=SAMPLES_PER_BATCH_MAX, description="samples a datagram")
    budget_bytes_s: float = Field(default=16_000.0, ge=1500.0, description="B/s up in all, UDP and IP included")
    kept_samples: int = Field(default=16, ge=SAMPLES_PER_BATCH_MAX, le=1024, description="samples held while waiting")
    repeat_from_loss: float = Field(
        default=0.2,
        gt=0.0,
        le=1.0,
        description="share of offboard's datagrams lost from which batches go twice; 1: never",
    )
    repeat_after_s: float = Field(
        default=0.15, ge=0.0, le=1.0, description="s to the second time; well below offboard's labels.reorder_s"
    )


class _Repeat(NamedTuple):
    due_ns: int
    batch: SampleBatch


def _cost_bytes(samples: int) -> int:
    """Bytes that a batch of `samples` takes from the budget."""
    return BATCH_OVERHEAD_BYTES + samples * SAMPLE_BYTES


@dataclass(slots=True)
class _Sample:
    index: int
    time_ns: int
    version: int | None
    signals: NDArray[np.float32]
    delivered: NDArray[np.float32]
    adaptive: NDArray[np.float32]


class SampleQueue:
    """Collects ticks and returns batches."""

    def __init__(self, config: SamplerConfig) -> None:
        self._config = config
        self._period_ns = round(1e9 / config.rate_hz)
        self._repeat_after_ns = round(config.repeat_after_s * 1e9)
        self._waiting: deque[_Sample] = deque(maxlen=config.kept_samples)
        self._sum = np.zeros((len(CHANNELS), 3))
        self._ticks = 0
        self._start_ns: int | None = None
        self._due_ns = 0
        self._pushed_ns = 0
        self._allowance_bytes = _BURST_BYTES
        self._refilled_ns: int | None = None
        self._repeats: deque[_Repeat] = deque()
        self.taken = 0
        """Samples taken since start."""
        self.dropped = 0
        """Samples dropped because the budget did not suffice."""
        self.repeated = 0
        """Samples sent a second time."""

    @property
    def counts(self) -> dict[str, int]:
        """How many samples were taken, dropped and repeated."""
        return {"taken": self.taken, "dropped": self.dropped, "repeated": self.repeated}

    def push(self, time_ns: int, signals: Array, u_hat: Sequence[Array], nu_ad: Sequence[Array]) -> None:
        """Add one tick: signals [SIGNAL_COUNT]; u_hat and nu_ad [2, 3] each, position and attitude; all are copied."""
        if self._start_ns is None:
            self._start_ns = self._due_ns = time_ns
        elif time_ns - self._pushed_ns > self._period_ns:  # a pause: no mean spans it
            self._sum[:] = 0.0
            self._ticks = 0
        self._pushed_ns = time_ns
        self._sum += np.asarray(u_hat)
        self._ticks += 1
        if time_ns < self._due_ns:
            return
        place = (time_ns - self._start_ns) // self._period_ns
        self._due_ns = self._start_ns + (place + 1) * self._period_ns
        self._take(place, time_ns, signals, np.asarray(nu_ad))

    def _take(self, index: int, time_ns: int, signals: Array, adaptive: Array) -> None:
        mean = (self._sum / self._ticks).astype(np.float32)
        self._sum[:] = 0.0
        self._ticks = 0
        self.dropped += len(self._waiting) == self._config.kept_samples
        self._waiting.append(
            _Sample(index, time_ns, None, signals.astype(np.float32), mean, adaptive.astype(np.float32))
        )
        self.taken += 1

    def poll(self, now_ns: int, feature_version: int, loss: float = 0.0) -> list[SampleBatch]:
        """The batches to send now.

        Parameters
        ----------
        feature_version: version in use for the samples taken since the last poll.
        loss: share of datagrams that the link loses.
        """
        if not self._waiting and not self._repeats:
            return []
        for sample in reversed(self._waiting):
            if sample.version is not None:
                break
            sample.version = feature_version
        self._refill(now_ns)
        repeat = self._config.repeat_from_loss <= loss < 1.0
        batches: list[SampleBatch] = []
        while run := self._ready_run(now_ns):
            cost = _cost_bytes(run)
            if cost > self._allowance_bytes:
                break
            self._allowance_bytes -= cost
            batches.append(self._batch([self._waiting.popleft() for _ in range(run)]))
            if repeat:
                self._repeats.append(_Repeat(now_ns + self._repeat_after_ns, batches[-1]))
        return batches + self._due_repeats(now_ns)

    def _due_repeats(self, now_ns: int) -> list[SampleBatch]:
        """Batches to repeat now, as long as the budget has room for a batch of new samples as well."""
        batches: list[SampleBatch] = []
        new_bytes = _cost_bytes(self._config.batch_samples)
        while self._repeats and self._repeats[0].due_ns <= now_ns:
            batch = self._repeats.popleft().batch
            samples = batch.signals.shape[0]
            cost = _cost_bytes(samples)
            if cost + new_bytes <= self._allowance_bytes:
                self._allowance_bytes -= cost
                self.repeated += samples
                batches.append(batch)
        return batches

    def charge(self, datagram_bytes: int, now_ns: int) -> None:
        """Take a datagram that is not a batch (status, time sync) from the budget. It is sent in any case."""
        self._refill(now_ns)
        self._allowance_bytes -= datagram_bytes + NETWORK_BYTES

    def _refill(self, now_ns: int) -> None:
        since_ns = 0 if self._refilled_ns is None else max(0, now_ns - self._refilled_ns)
        self._refilled_ns = now_ns
        earned = since_ns * 1e-9 * self._config.budget_bytes_s
        self._allowance_bytes = min(_BURST_BYTES, self._allowance_bytes + earned)

    def _ready_run(self, now_ns: int) -> int:
        """Length of the next batch: full, ended by a gap or a new version, or overdue; 0 to wait."""
        if not self._waiting:
            return 0
        head, most = self._waiting[0], self._config.batch_samples
        run = 0
        for sample in self._waiting:
            if run == most or sample.index != head.index + run or sample.version != head.version:
                return run
            run += 1
        overdue = now_ns - head.time_ns > (most + 1) * self._period_ns
        return run if run == most or overdue else 0

    def _batch(self, samples: list[_Sample]) -> SampleBatch:
        first = samples[0]
        return SampleBatch(
            first.index,
            first.time_ns,
            self._period_ns,
            first.version or 0,
            np.array([sample.signals for sample in samples]),
            np.array([sample.delivered for sample in samples]),
            np.array([sample.adaptive for sample in samples]),
        )
