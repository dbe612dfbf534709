"""What a round learns from: the training samples, and how likely each of them is drawn."""

import numpy as np

from offboard.config import BufferConfig
from offboard.data.buffer import SampleTable
from protocol.conventions import Array


def of_split(table: SampleTable, split: int) -> SampleTable:
    """The samples of a split."""
    return table.take(table.split == split)


def draw_probability(config: BufferConfig, newest: SampleTable, buffer: SampleTable) -> Array:
    """Probability with which a mini-batch draws each row, [n]: the newest (later ones more often), then the buffer."""
    share = config.newest_fraction if newest.rows and buffer.rows else float(newest.rows > 0)
    fading = np.exp(-np.arange(newest.rows)[::-1] / config.newest_scale)
    of_newest = share * fading / max(float(fading.sum()), 1e-12)
    of_buffer = np.full(buffer.rows, (1.0 - share) / max(buffer.rows, 1))
    return np.concatenate([of_newest, of_buffer])
