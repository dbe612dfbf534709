"""Training on a user's own samples: the job for the trainer of the flight (offboard.training.round)."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from offboard.config import BufferConfig, TrainerConfig
from offboard.data.buffer import TRAINING, SampleTable, split_of_block
from offboard.training.job import TrainerState
from offboard.training.network import InputPlan, initial_state
from protocol.conventions import Array

CHANNEL = "outputs"
"""Name of the one channel of a learner."""


@dataclass(frozen=True)
class OwnNetworks:
    """Shape of the networks of one channel with any inputs and outputs (offboard.training.network.NetworkConfig)."""

    signals: tuple[str, ...]
    outputs: int
    hidden: tuple[int, ...]
    count: int
    """k, features, the constant included."""
    offset: Array
    """[m], of the inputs."""
    scale: Array
    """[m], of the inputs."""
    spectral_norm_max: float = 2.5
    first_layer_gain: float = 1.0
    dropout: float = 0.0
    scaling: str = "fixed"
    all_channels: tuple[str, ...] = (CHANNEL,)
    channels: tuple[str, ...] = (CHANNEL,)

    def inputs(self, channel: str) -> tuple[str, ...]:
        """All signals."""
        del channel
        return self.signals

    def offset_and_scale(self, names: tuple[str, ...]) -> tuple[Array, Array]:
        """Of the named signals, [m] each."""
        at = [self.signals.index(name) for name in names]
        return self.offset[at], self.scale[at]

    @property
    def plan(self) -> InputPlan:
        """Inputs and outputs, for the trainer."""
        return InputPlan.of(self)

    def start(self, seed: int) -> TrainerState:
        """Random inner layers, last layer zero."""
        return TrainerState(initial_state(self, np.random.default_rng([seed, 1])), (), 0, 0)


@dataclass(frozen=True)
class OwnJob:
    """A round of training on a table of samples (offboard.training.job.RoundJob)."""

    network_config: OwnNetworks
    config: TrainerConfig
    seed: int
    state: TrainerState
    buffer: SampleTable
    label_floors: tuple[float, ...]
    buffer_config: BufferConfig = field(default_factory=BufferConfig)

    @property
    def newest(self) -> SampleTable:
        """No sample counts more than another."""
        return self.buffer.take(slice(0, 0))


def sample_table(signals: Array, labels: Array, period_s: float, block_s: float, seed: int) -> SampleTable:
    """Samples in the order of time as the trainer's table, split by blocks of time.

    Parameters
    ----------
    signals: [n, m]. labels: [n, q]; a row with NaN has no label.
    block_s: s, length of a block. One block in five is held out for validation, one in twenty for testing.
    """
    rows = np.arange(signals.shape[0])
    config = BufferConfig()
    blocks = rows // max(round(block_s / period_s), 1)
    groups = config.blocks_per_group, config.groups_per_test
    split_of = [split_of_block(block, seed, *groups) for block in range(int(blocks[-1]) + 1 if rows.size else 0)]
    split = np.array([split_of[block] for block in blocks.tolist()], dtype=np.int8)
    known = labels.copy()
    known[np.isnan(labels).any(axis=1)] = np.nan
    return SampleTable(
        time_ns=np.round(rows * period_s * 1e9).astype(np.int64),
        signals=signals.astype(np.float32),
        labels=known[:, None].astype(np.float32),
        split=split,
        condition=np.zeros(rows.size, dtype=np.int32),
    )


def training_rows(table: SampleTable) -> int:
    """Samples to train on that have a label."""
    return int(((table.split == TRAINING) & ~np.isnan(table.labels[:, 0, 0])).sum())


def usual_size(values: Sequence[float] | Array) -> Array:
    """Root mean square of each column [n, q], NaN left out; 1 for a column of zeros."""
    size = np.sqrt(np.nanmean(np.square(values), axis=0))
    found: Array = np.where(size > 0.0, size, 1.0)
    return found
