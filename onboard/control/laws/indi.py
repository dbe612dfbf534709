"""Incremental nonlinear dynamic inversion (INDI; Smeur, Chu, de Croon 2016)."""

from math import exp
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from configs.loader import ConfigRecord
from onboard.control.laws.law import ChannelState
from onboard.control.records import ChannelTelemetry
from protocol.conventions import Array


class IncrementalConfig(ConfigRecord):
    """Settings of INDI's filter, which the laws on top of INDI share."""

    filter_s: Annotated[float, Field(ge=0.005, le=2, description="time constant on x_dot and u_hat alike")]
    limit: Annotated[float, Field(gt=0, description="bound on each axis of nu_ad, units of u")]


class IndiConfig(IncrementalConfig):
    """Settings of INDI."""

    kind: Literal["indi"]


class IncrementalFilter:
    """F: first order, the same for x_dot and u_hat, so it sees their difference; bounded on each axis."""

    def __init__(self, config: IncrementalConfig) -> None:
        self._filter_s, self._limit = config.filter_s, config.limit
        self.value: Array = np.zeros(3)
        """[3], units of u."""

    def step(self, difference: Array, dt: float) -> Array:
        """One step with x_dot - u_hat [3], or what is left of it; returns the new value."""
        share = 1.0 - exp(-dt / self._filter_s)
        self.value = (self.value + share * (difference - self.value)).clip(-self._limit, self._limit)
        return self.value

    def reset(self) -> None:
        """Set the value to zero."""
        self.value = np.zeros(3)


class Indi:
    """u = u_0 + (demand - x_dot_0), both with the same filter: nu_ad = F(x_dot - u_hat)."""

    def __init__(self, config: IndiConfig) -> None:
        self._filter = IncrementalFilter(config)

    def step(self, channel: ChannelState, telemetry: ChannelTelemetry) -> Array:
        """One step of the filter; returns nu_ad."""
        if channel.adapt:
            self._filter.step(channel.residual, channel.dt)
        telemetry.adaptive_now[:] = self._filter.value
        return self._filter.value

    def reset(self) -> None:
        """Set the filter to zero."""
        self._filter.reset()
