"""The stored samples: a buffer of samples that were new when they came, and a ring of the newest samples.

The buffer covers the whole flight evenly; the ring follows a change at once. After an abrupt fault the two hold
different labels for the same state. Each mini-batch draws from both, and a sample that is similar to a buffer entry
older than `refresh_age_s` replaces it, so that outdated labels disappear where the vehicle flies.

Each sample has the number of a condition: the flight that it is from. A sample is new, and replaces a similar one,
among those of its own condition only, so that a flight in a new wind does not overwrite what was stored at the same
place in an old one. A round of training uses the samples of the present condition, and those of others where the
present one has none yet. A full buffer deletes from the condition with the most samples.

Samples are split by time: all samples of a time block go to training, validation or test together, because samples
that follow each other are nearly equal.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from offboard.config import BufferConfig
from offboard.data.labels import LabelledSample
from offboard.data.novelty import HistoryNovelty, KernelNovelty, swap_for_largest_sigma_min
from protocol.conventions import Array
from protocol.feature_config import FeatureInputs
from protocol.signals import CHANNELS, SIGNAL_COUNT, input_indices

TRAINING: Final = 0
VALIDATION: Final = 1
TEST: Final = 2
COLUMNS: Final = ("time_ns", "signals", "labels", "split", "condition")
"""The fields of SampleTable, in their order."""
SAME_PLACE: Final = 1.0
"""Kernel widths between two samples of different conditions below which they are at the same place."""


@dataclass(frozen=True, slots=True, eq=False)
class SampleTable:
    """Samples as columns, with one row per sample."""

    time_ns: NDArray[np.int64]
    """[n]"""
    signals: NDArray[np.float32]
    """[n, SIGNAL_COUNT]"""
    labels: NDArray[np.float32]
    """[n, 2, 3]: Delta of each channel, m/s^2 and rad/s^2; NaN where a channel has no label."""
    split: NDArray[np.int8]
    """[n]: TRAINING, VALIDATION or TEST."""
    condition: NDArray[np.int32]
    """[n]: number of the condition, from 0."""

    @staticmethod
    def empty(rows: int) -> "SampleTable":
        """A table of `rows` zero rows."""
        return SampleTable(
            np.zeros(rows, dtype=np.int64),
            np.zeros((rows, SIGNAL_COUNT), dtype=np.float32),
            np.zeros((rows, len(CHANNELS), 3), dtype=np.float32),
            np.zeros(rows, dtype=np.int8),
            np.zeros(rows, dtype=np.int32),
        )

    @property
    def rows(self) -> int:
        """Number of rows."""
        return int(self.time_ns.shape[0])

    def take(self, rows: slice | NDArray[np.intp] | NDArray[np.bool_]) -> "SampleTable":
        """A copy of some rows."""
        return SampleTable(*(getattr(self, column)[rows].copy() for column in COLUMNS))

    def released(self, before_ns: int) -> "SampleTable":
        """The same table, with the validation samples older than `before_ns` assigned to training."""
        old = (self.split == VALIDATION) & (self.time_ns < before_ns)
        return replace(self, split=np.where(old, TRAINING, self.split).astype(np.int8))

    def put(self, row: int, sample: LabelledSample, split: int) -> None:
        """Write one row."""
        self.time_ns[row] = sample.time_ns
        self.signals[row] = sample.signals
        self.labels[row] = sample.labels
        self.split[row] = split
        self.condition[row] = sample.condition

    def put_rows(self, rows: "SampleTable") -> None:
        """Overwrite the first rows with `rows`."""
        for column in COLUMNS:
            getattr(self, column)[: rows.rows] = getattr(rows, column)

    def joined(self, other: "SampleTable") -> "SampleTable":
        """The rows of this table, followed by those of the other one."""
        return SampleTable(*(np.concatenate([getattr(self, name), getattr(other, name)]) for name in COLUMNS))


def split_of_block(block: int, seed: int, blocks_per_group: int, groups_per_test: int) -> int:
    """The split that a time block belongs to.

    One block of each group is held out for validation, and one in every `groups_per_test` groups for testing. Their
    places in the group are random: with fixed places, and laps as long as a group, the same stretch of the path would
    always be held out.
    """
    group, place = divmod(block, blocks_per_group)
    drawn = np.random.default_rng([seed, 11, group]).permutation(blocks_per_group)
    if place == drawn[0]:
        return VALIDATION
    return TEST if place == drawn[1] and group % groups_per_test == 0 else TRAINING


FeatureFunction = Callable[[NDArray[np.float32]], Array]
"""Phi [n, k] of signals [n, SIGNAL_COUNT], the features of all channels side by side."""


class NoveltyBuffer:
    """At most `capacity` samples that differ enough from each other."""

    def __init__(self, config: BufferConfig, inputs: FeatureInputs, features: FeatureFunction) -> None:
        self._config = config
        self._features = features
        self._inputs = input_indices(config.novelty_inputs)
        self._offset, scale = inputs.offset_and_scale(config.novelty_inputs)
        self._width = scale * config.kernel_width
        self.table = SampleTable.empty(config.capacity)
        self._entered = np.zeros(config.capacity, dtype=np.int64)
        self._admitted = 0
        self._kernel = KernelNovelty(config.capacity, len(self._inputs))
        self._history = HistoryNovelty(config.history_tolerance)
        self._stack: Array | None = None
        """Phi of every slot, [capacity, k]; None until it is needed with the current features."""
        self._gram = np.zeros((0, 0))
        self._asked: tuple[LabelledSample, Array] | None = None
        self.count = 0

    def consider(self, sample: LabelledSample, split: int) -> bool:
        """Store a sample if it is new, in place of another one if the buffer is full; returns whether it was stored."""
        if self._config.admission == "history":
            self._need_stack()
            phi = self._phi(sample)
            if not self._history.is_new(phi):
                return False
            self._admit(sample, split)
            return True
        gamma, nearest = self._kernel.gamma(self._point(sample.signals), sample.condition)
        if gamma >= self._config.kernel_tolerance:
            self._admit(sample, split)
            return True
        young = sample.time_ns - self.table.time_ns[nearest] < self._config.refresh_age_s * 1e9
        if young or bool((np.isnan(sample.labels) & ~np.isnan(self.table.labels[nearest])).any()):
            return False
        self._replace(nearest, sample, split)
        return True

    def rows(self) -> SampleTable:
        """A copy of the stored samples."""
        return self.table.take(slice(0, self.count))

    def rows_for(self, condition: int) -> SampleTable:
        """A copy of the samples of a condition, and of those of the others where it has none similar."""
        rows = self.rows()
        own = rows.condition == condition
        if own.all() or not own.any():
            return rows
        points = self._point(rows.signals.astype(np.float64))
        theirs, ours = points[~own], points[own]
        squares = (theirs**2).sum(axis=1)[:, None] + (ours**2).sum(axis=1) - 2.0 * theirs @ ours.T
        used = own.copy()
        used[~own] = squares.min(axis=1) > SAME_PLACE**2
        return rows.take(used)

    def set_features(self, features: FeatureFunction) -> None:
        """Use other features. Their stack is computed when it is next needed."""
        self._features = features
        self._stack = None
        self._asked = None

    @property
    def order(self) -> NDArray[np.int64]:
        """Running number of each of `rows`, in the order in which they were stored."""
        return self._entered[: self.count].copy()

    def load(self, rows: SampleTable, order: NDArray[np.int64]) -> None:
        """Start from the rows of a checkpoint and their `order`."""
        rows = rows.take(slice(0, self._config.capacity))
        self.count = rows.rows
        self._kernel = KernelNovelty(self._config.capacity, len(self._inputs))
        self.table.put_rows(rows)
        for slot in range(self.count):
            self._kernel.add(slot, self._point(rows.signals[slot].astype(np.float64)), int(rows.condition[slot]))
        self._entered[: self.count] = order[: self.count]
        self._admitted = int(order.max(initial=-1)) + 1
        self._stack = None

    def _point(self, signals: Array) -> Array:
        """The inputs of the kernel, [..., inputs], of signals [..., SIGNAL_COUNT]."""
        point: Array = (signals[..., self._inputs] - self._offset) / self._width
        return point

    def _phi(self, sample: LabelledSample) -> Array:
        """Features of a sample, [k]; cached, because one admission needs them several times."""
        if self._asked is None or self._asked[0] is not sample:
            self._asked = (sample, self._features(sample.signals[None].astype(np.float32))[0])
        return self._asked[1]

    def _need_stack(self) -> Array:
        if self._stack is not None:
            return self._stack
        Phi = self._features(self.table.signals)
        self._gram = Phi[: self.count].T @ Phi[: self.count]
        self._stack = Phi
        if self.count and self._config.admission == "history":
            self._history.rebuild(self._gram, Phi[int(np.argmax(self._entered[: self.count]))])
        return Phi

    def _admit(self, sample: LabelledSample, split: int) -> None:
        if self.count < self._config.capacity:
            self.count += 1
            if self._config.admission == "kernel":
                self._kernel.add(self.count - 1, self._point(sample.signals), sample.condition)
            self._fill(self.count - 1, sample, split)
            return
        slots = self._largest_condition(sample.condition)
        if self._config.deletion == "svd":
            Phi, gram = self._need_stack(), self._gram
            if slots.size < self.count:
                Phi = Phi[slots]
                gram = Phi.T @ Phi
            self._replace(int(slots[swap_for_largest_sigma_min(Phi, gram, self._phi(sample))]), sample, split)
        else:
            self._replace(int(slots[np.argmin(self._entered[slots])]), sample, split)

    def _largest_condition(self, condition: int) -> NDArray[np.intp]:
        """Slots of the condition with the most samples; of several equal ones `condition`, else the oldest."""
        stored = self.table.condition[: self.count]
        conditions, counts = np.unique(stored, return_counts=True)
        largest = conditions[counts == counts.max()]
        return np.flatnonzero(stored == (condition if condition in largest else largest[0]))

    def _replace(self, slot: int, sample: LabelledSample, split: int) -> None:
        if self._config.admission == "kernel":
            self._kernel.replace(slot, self._point(sample.signals), sample.condition)
        if self._stack is not None:
            self._gram -= np.outer(self._stack[slot], self._stack[slot])
        self._fill(slot, sample, split)
        if self._stack is not None and self._config.admission == "history":
            self._history.rebuild(self._gram, self._stack[slot])

    def _fill(self, slot: int, sample: LabelledSample, split: int) -> None:
        self.table.put(slot, sample, split)
        self._entered[slot] = self._admitted
        self._admitted += 1
        if self._stack is not None:
            phi = self._phi(sample)
            self._stack[slot] = phi
            self._gram += np.outer(phi, phi)
            if self._config.admission == "history":
                self._history.add(phi)


class NewestRing:
    """The newest samples, whether new or not."""

    def __init__(self, capacity: int) -> None:
        self.table = SampleTable.empty(capacity)
        self._written = 0

    def put(self, sample: LabelledSample, split: int) -> None:
        """Store a sample in place of the oldest one."""
        self.table.put(self._written % self.table.rows, sample, split)
        self._written += 1

    def rows(self) -> SampleTable:
        """A copy of the stored samples, oldest first."""
        capacity = self.table.rows
        if self._written <= capacity:
            return self.table.take(slice(0, self._written))
        start = self._written % capacity
        return self.table.take(np.r_[start:capacity, 0:start])

    def load(self, rows: SampleTable) -> None:
        """Start from the rows of a checkpoint, oldest first."""
        rows = rows.take(slice(max(0, rows.rows - self.table.rows), rows.rows))
        self.table.put_rows(rows)
        self._written = rows.rows
