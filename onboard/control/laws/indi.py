"""Incremental nonlinear dynamic inversion (INDI; Smeur, Chu, de Croon 2016)."""

from math import exp
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from configs.loader import ConfigRecord
from onboard.control.laws.law import ChannelState
from onboard.control.records import ChannelTelemetry
from protocol.conventions import Array


class IndiConfig(ConfigRecord):
    """Settings of INDI."""

    kind: Literal["indi"]
    filter_s: Annotated[float, Field(ge=0.005, le=2, description="time constant on x_dot and u_hat alike")]
    limit: Annotated[float, Field(gt=0, description="bound on each axis of nu_ad, units of u")]


class Indi:
    """u = u_0 + (demand - x_dot_0), both with the same filter: nu_ad = filtered(x_dot - u_hat)."""

    def __init__(self, config: IndiConfig) -> None:
        self._config = config
        self._nu: Array = np.zeros(3)

    def step(self, channel: ChannelState, telemetry: ChannelTelemetry) -> Array:
        """One step of the filter; returns nu_ad."""
        if channel.adapt:
            share = 1.0 - exp(-channel.dt / self._config.filter_s)
            limit = self._config.limit
            self._nu = (self._nu + share * (channel.residual - self._nu)).clip(-limit, limit)
        telemetry.adaptive_now[:] = self._nu
        return self._nu

    def reset(self) -> None:
        """Set the filter to zero."""
        self._nu = np.zeros(3)
