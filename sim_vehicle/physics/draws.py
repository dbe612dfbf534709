"""Random draws in blocks, because single draws cost more than the physics."""

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.random import Generator

from protocol.conventions import Array

BLOCK = 2048
SUBSTEPS_MAX: Final = 400
"""Sub-steps in one call of the compiled step; less than a block of SubstepNormals."""


class Draws:
    """Draws of one distribution, one float at a time. draw: a method of a generator, such as `standard_normal`."""

    def __init__(self, draw: Callable[[int], Array]) -> None:
        self._draw = draw
        self._block: list[float] = []

    def take(self) -> float:
        """The next draw."""
        if not self._block:
            self._block = self._draw(BLOCK).tolist()
        return self._block.pop()

    def several(self, count: int) -> list[float]:
        """The next `count` draws, the same as from `count` calls of `take`."""
        block = self._block
        if len(block) < count:
            return [self.take() for _ in range(count)]
        drawn = block[: -count - 1 : -1]
        del block[-count:]
        return drawn


class NormalRows:
    """Unit normal draws, `width` at a time."""

    def __init__(self, rng: Generator, width: int) -> None:
        self._rng = rng
        self._shape = (BLOCK // width, width)
        self._rows: list[Array] = []

    def take(self) -> Array:
        """[width], the next draws."""
        if not self._rows:
            self._rows = list(self._rng.standard_normal(self._shape))
        return self._rows.pop()


class SubstepNormals:
    """Unit normal draws for the sub-steps: [rows, per_row] for each, in order."""

    def __init__(self, rng: Generator, rows: int, per_row: int) -> None:
        self._rng = rng
        self._shape = (BLOCK // 4, rows, per_row)
        self._block: Array = np.zeros((0, rows, per_row))
        self._next = 0

    def take(self, count: int) -> Array:
        """[count, rows, per_row] draws of the next `count` sub-steps, at most BLOCK / 4."""
        end = self._next + count
        if end > len(self._block):
            rest = self._block[self._next :]
            self._block = np.concatenate([rest, self._rng.standard_normal(self._shape)])
            self._next, end = 0, count
        view = self._block[self._next : end]
        self._next = end
        return view
