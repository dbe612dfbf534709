"""Random draws in blocks, because one draw at a time costs more than the physics."""

import numpy as np
from numpy.random import Generator

from sim_vehicle.records import Array

BLOCK = 2048


class Normals:
    """Unit normal draws, one float at a time."""

    def __init__(self, rng: Generator) -> None:
        self._rng = rng
        self._block: list[float] = []

    def take(self) -> float:
        """The next draw."""
        if not self._block:
            self._block = self._rng.standard_normal(BLOCK).tolist()
        return self._block.pop()

    def several(self, count: int) -> list[float]:
        """The next `count` draws, as so many calls of `take` would give them."""
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


class Uniforms:
    """Uniform draws from [0, 1), one float at a time."""

    def __init__(self, rng: Generator) -> None:
        self._rng = rng
        self._block: list[float] = []

    def take(self) -> float:
        """The next draw."""
        if not self._block:
            self._block = self._rng.random(BLOCK).tolist()
        return self._block.pop()


class SubstepNormals:
    """Unit normal draws for the sub-steps: `width` for each, in order."""

    def __init__(self, rng: Generator, rows: int, per_row: int) -> None:
        self._rng = rng
        self._shape = (BLOCK // 4, rows, per_row)
        self._block: Array = np.zeros((0, rows, per_row))
        self._next = 0

    def take(self, count: int) -> Array:
        """[count, rows, per_row]: draws of the next `count` sub-steps (at most BLOCK / 4), however they are called."""
        end = self._next + count
        if end > len(self._block):
            rest = self._block[self._next :]
            self._block = np.concatenate([rest, self._rng.standard_normal(self._shape)])
            self._next, end = 0, count
        view = self._block[self._next : end]
        self._next = end
        return view
