"""A table over the lap: one vector for each bin of lap phase. The laws that learn over laps share it."""

from math import exp
from typing import Annotated

import numpy as np
from pydantic import Field

from onboard.control.laws.indi import IncrementalConfig
from protocol.conventions import Array


class LapConfig(IncrementalConfig):
    """Settings that the laws over laps share; INDI's filter takes what the table does not contain."""

    bins: Annotated[int, Field(ge=8, le=2000, description="of lap phase")] = 150
    lead_s: Annotated[float, Field(ge=0, le=0.5, description="lag of the loop, by which the table leads")]


class LapTable:
    """A periodic table of nu_ad over lap phase, read with linear interpolation and faded in and out."""

    def __init__(self, bins: int, fade_s: float) -> None:
        """fade_s: time constant with which the table's share follows whether the path repeats."""
        self.values: Array = np.zeros((bins, 3))
        """[bins, 3], units of u, each at the centre of its bin."""
        self._fade_s = fade_s
        self._share = 0.0
        self._phase = 0.0

    def bin(self, phase: float) -> int:
        """Index of the bin that holds a lap phase, of any lap."""
        bins = len(self.values)
        return min(int((phase % 1.0) * bins), bins - 1)  # -1e-17 % 1.0 is rounded to 1.0

    def follow(self, phase: float, dt: float) -> None:
        """Remember the lap phase; while it is negative, the table's share fades at the last known phase."""
        if phase >= 0.0:
            self._phase = phase
        self._share += (1.0 - exp(-dt / self._fade_s)) * ((1.0 if phase >= 0.0 else 0.0) - self._share)

    def ahead(self, lead: float) -> Array:
        """nu_ad [3] of the table, `lead` of a lap after the present phase, times the table's share."""
        bins = len(self.values)
        place = (self._phase + lead) * bins - 0.5
        below = int(place // 1.0)
        weight = place - below
        before, after = self.values[below % bins], self.values[(below + 1) % bins]
        value: Array = self._share * ((1.0 - weight) * before + weight * after)
        return value

    def reset(self) -> None:
        """Set the share to zero. What was learnt stays."""
        self._share = 0.0
