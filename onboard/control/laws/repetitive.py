"""Repetitive control on top of INDI: the residual of earlier laps, by lap phase, read ahead by the lag of the loop.

    nu_ad  = T(theta + lead) + F(r - T(theta)),    F: first-order filter of INDI, r: the residual x_dot - u_hat
    T(b)  += share (mean of Delta_hat over bin b - T(b)),    once per lap; share = max(1 / laps, learning)

Delta_hat is the residual after a filter of its own; its lag is taken out of the phase at which it is stored. While the
path does not repeat, T fades out with the time constant of F, and the law is INDI (laws/indi.py) alone.
"""

from math import exp
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from onboard.control.laws.indi import IncrementalFilter
from onboard.control.laws.lap_table import LapConfig, LapTable
from onboard.control.laws.law import ChannelState
from onboard.control.records import ChannelTelemetry
from protocol.conventions import Array


class RepetitiveConfig(LapConfig):
    """Settings of repetitive control."""

    kind: Literal["repetitive"]
    residual_filter_s: Annotated[float, Field(ge=0.005, le=1, description="time constant on the residual to be stored")]
    learning: Annotated[float, Field(gt=0, le=1, description="least share of a new lap in the table")]


class Repetitive:
    """INDI with a table of the residual over the lap."""

    def __init__(self, config: RepetitiveConfig) -> None:
        self._config = config
        self.table = LapTable(config.bins, config.filter_s)
        self._laps = np.zeros(config.bins, dtype=int)
        self._bin = -1
        self._sum: Array = np.zeros(3)
        self._count = 0
        self._Delta_hat: Array = np.zeros(3)
        self._rest = IncrementalFilter(config)
        self._now: Array = np.zeros(3)
        self._nu: Array = np.zeros(3)

    def step(self, channel: ChannelState, telemetry: ChannelTelemetry) -> Array:
        """Store the residual, read the table, filter the rest; returns nu_ad."""
        if channel.adapt:
            config, limit = self._config, self._config.limit
            self._learn(channel)
            self.table.follow(channel.lap_phase, channel.dt)
            now = self.table.ahead(0.0)
            ahead = self.table.ahead(config.lead_s / channel.lap_s) if channel.lap_s > 0.0 else now
            rest = self._rest.step(channel.residual - now, channel.dt)
            self._now = (now + rest).clip(-limit, limit)
            self._nu = (ahead + rest).clip(-limit, limit)
        telemetry.adaptive_now[:] = self._now
        telemetry.residual[:] = self._Delta_hat
        return self._nu

    def _learn(self, channel: ChannelState) -> None:
        """Average Delta_hat over the bin it was measured in, and store the mean when the next bin begins."""
        filter_s = self._config.residual_filter_s
        self._Delta_hat = self._Delta_hat + (1.0 - exp(-channel.dt / filter_s)) * (channel.residual - self._Delta_hat)
        if channel.lap_phase < 0.0:
            self._begin(-1)
            return
        measured = self.table.bin(channel.lap_phase - filter_s / channel.lap_s)
        if measured != self._bin:
            self._store()
            self._begin(measured)
        self._sum += self._Delta_hat
        self._count += 1

    def _store(self) -> None:
        if self._bin < 0:
            return
        self._laps[self._bin] += 1
        share = max(1.0 / self._laps[self._bin], self._config.learning)
        values = self.table.values
        values[self._bin] += share * (self._sum / self._count - values[self._bin])

    def _begin(self, number: int) -> None:
        """Start the average of a bin; -1 for none."""
        self._bin, self._count = number, 0
        self._sum[:] = 0.0

    def reset(self) -> None:
        """Set the filters to zero. The table stays."""
        self.table.reset()
        self._rest.reset()
        self._begin(-1)
        self._Delta_hat, self._now, self._nu = (np.zeros(3) for _ in range(3))
