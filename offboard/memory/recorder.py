"""The samples of the flight under way, spread evenly over it, for the memory."""

from typing import Final

import numpy as np

from offboard.data.buffer import TRAINING, SampleTable
from offboard.data.labels import LabelledSample
from offboard.memory.memory import SAMPLES_PER_CONDITION

_ROWS: Final = 2 * SAMPLES_PER_CONDITION


class FlightRecorder:
    """Stores every n-th labelled sample; n doubles, and half of the stored ones go, whenever the table is full."""

    def __init__(self) -> None:
        self._table = SampleTable.empty(_ROWS)
        self._count = 0
        self._step = 1
        self._seen = 0

    def put(self, sample: LabelledSample) -> None:
        """Consider the next sample."""
        if self._seen % self._step == 0:
            if self._count == _ROWS:
                kept = self._table.take(np.arange(0, _ROWS, 2))
                self._table.put_rows(kept)
                self._count, self._step = kept.rows, 2 * self._step
            self._table.put(self._count, sample, TRAINING)
            self._count += 1
        self._seen += 1

    def samples(self) -> SampleTable:
        """A copy of the stored samples, oldest first."""
        return self._table.take(slice(0, self._count))
