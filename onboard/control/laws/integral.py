"""The integral of a PID controller."""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from configs.loader import ConfigRecord
from onboard.control.laws.law import ChannelState
from onboard.control.records import ChannelTelemetry
from protocol.conventions import Array

Gain3 = tuple[
    Annotated[float, Field(ge=0, le=5000)],
    Annotated[float, Field(ge=0, le=5000)],
    Annotated[float, Field(ge=0, le=5000)],
]


class IntegralConfig(ConfigRecord):
    """Settings of the integral."""

    kind: Literal["integral"]
    gain: Gain3
    """1/s^3: u per second and unit of position (or angle) error."""
    limit: Annotated[float, Field(gt=0, description="bound on each axis of nu_ad, units of u")]


class Integral:
    """nu_ad = -K_i int(target - state) dt, held while the motors are saturated and clamped (anti-windup)."""

    def __init__(self, config: IntegralConfig) -> None:
        self._gain = config.gain
        self._limit = config.limit
        self._nu: Array = np.zeros(3)

    def step(self, channel: ChannelState, telemetry: ChannelTelemetry) -> Array:
        """One step of the integral; returns nu_ad."""
        nu, limit = self._nu, self._limit
        if channel.adapt:
            errors = channel.tracking_error.tolist()
            for axis, now in enumerate(nu.tolist()):
                change = -channel.dt * self._gain[axis] * errors[axis]
                if channel.saturated and not change * now < 0.0:  # anti-windup: only unwinding is allowed
                    continue
                nu[axis] = min(max(now + change, -limit), limit)
        telemetry.adaptive_now[:] = nu
        return nu

    def reset(self) -> None:
        """Set the integral to zero."""
        self._nu[:] = 0.0
