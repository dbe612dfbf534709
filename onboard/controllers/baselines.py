"""The baselines' augmentations: none, integral (PID), piecewise-constant L1, and incremental inversion (INDI)."""

from math import exp
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from configs.loader import Record
from onboard.control_records import ChannelTelemetry
from onboard.controllers.augmentation import ChannelState

Array = NDArray[np.float64]
Gain3 = tuple[
    Annotated[float, Field(ge=0, le=5000)],
    Annotated[float, Field(ge=0, le=5000)],
    Annotated[float, Field(ge=0, le=5000)],
]


class NoneConfig(Record):
    """No augmentation: proportional-derivative with feed-forward."""

    kind: Literal["none"]


class IntegralConfig(Record):
    """The integral of a PID controller."""

    kind: Literal["integral"]
    gain: Gain3
    """1/s^3: u per second and unit of position (or angle) error."""
    limit: Annotated[float, Field(gt=0, description="bound on each axis of nu_ad, units of u")]


class L1Config(Record):
    """L1 adaptive augmentation with the piecewise-constant law (Xargay, Hovakimyan, Cao 2010)."""

    kind: Literal["l1"]
    predictor_pole_rad_s: Annotated[float, Field(gt=0, le=200, description="-A_s of the state predictor")]
    bandwidth_rad_s: Annotated[float, Field(gt=0, le=200, description="of the low-pass filter C(s)")]
    limit: Annotated[float, Field(gt=0, description="bound on each axis of nu_ad, units of u")]


class IndiConfig(Record):
    """Incremental nonlinear dynamic inversion: the measured acceleration replaces the model (Smeur et al. 2016)."""

    kind: Literal["indi"]
    filter_s: Annotated[float, Field(ge=0.005, le=2, description="time constant on x_dot and u_hat alike")]
    limit: Annotated[float, Field(gt=0, description="bound on each axis of nu_ad, units of u")]


class NoAugmentation:
    """nu_ad = 0."""

    def __init__(self, config: NoneConfig) -> None:
        self._zero: Array = np.zeros(3)

    def step(self, channel: ChannelState, telemetry: ChannelTelemetry) -> Array:
        """Zero."""
        return self._zero

    def reset(self) -> None:
        """Nothing to forget."""


class Integral:
    """nu_ad = -K_i int(target - state) dt, held while the motors are saturated and clamped (anti-windup)."""

    def __init__(self, config: IntegralConfig) -> None:
        self._gain = config.gain
        self._limit = config.limit
        self._nu: Array = np.zeros(3)

    def step(self, channel: ChannelState, telemetry: ChannelTelemetry) -> Array:
        """One step of the integral."""
        nu, limit = self._nu, self._limit
        if channel.adapt:
            errors = channel.tracking_error.tolist()
            for axis, now in enumerate(nu.tolist()):
                change = -channel.dt * self._gain[axis] * errors[axis]
                if channel.saturated and not change * now < 0.0:  # conditional integration: only unwinding is allowed
                    continue
                nu[axis] = min(max(now + change, -limit), limit)
        telemetry.adaptive_now[:] = nu
        return nu

    def reset(self) -> None:
        """Integral to zero."""
        self._nu[:] = 0.0


class L1:
    """State predictor on the channel's rate with sigma_hat recomputed each step so that the prediction error dies out.

    v_hat_dot = u_hat + sigma_hat - a (v_hat - v); sigma_hat = -[a / (e^{a T} - 1)] (v_hat - v); nu_ad = C(s) sigma_hat.
    (With A_s = -a: Phi = A_s^-1 (e^{A_s T} - I), sigma_hat = -Phi^-1 e^{A_s T} v_tilde.)
    """

    def __init__(self, config: L1Config) -> None:
        self._config = config
        self._started = False
        self._prediction: Array = np.zeros(3)
        self._sigma: Array = np.zeros(3)
        self._nu: Array = np.zeros(3)

    def step(self, channel: ChannelState, telemetry: ChannelTelemetry) -> Array:
        """One step of predictor, adaptation and filter."""
        if channel.adapt:
            self._predict(channel)
        else:
            self._started = False
        telemetry.adaptive_now[:] = self._nu
        return self._nu

    def _predict(self, channel: ChannelState) -> None:
        a, T = self._config.predictor_pole_rad_s, channel.dt
        decay = exp(-a * T)
        if not self._started:
            error, self._sigma, self._started = np.zeros(3), self._nu.copy(), True
        else:
            # u_hat over the step that has just ended is known only now.
            error = self._prediction + T * channel.delivered - channel.rate
            self._sigma = -(a * decay / (1.0 - decay)) * error
        # Exact over the coming step for constant u_hat and sigma_hat: v_tilde decays, the rest integrates.
        self._prediction = channel.rate + decay * error + ((1.0 - decay) / a) * self._sigma
        share = 1.0 - exp(-self._config.bandwidth_rad_s * T)
        limit = self._config.limit
        self._nu = (self._nu + share * (self._sigma - self._nu)).clip(-limit, limit)

    def reset(self) -> None:
        """Predictor and filter start over."""
        self._started = False
        self._sigma = np.zeros(3)
        self._nu = np.zeros(3)


class Indi:
    """u = u_0 + (demand - x_dot_0) with u_0 and x_dot_0 filtered alike, which is nu_ad = filtered(x_dot - u_hat)."""

    def __init__(self, config: IndiConfig) -> None:
        self._config = config
        self._nu: Array = np.zeros(3)

    def step(self, channel: ChannelState, telemetry: ChannelTelemetry) -> Array:
        """One step of the synchronised filter."""
        if channel.adapt:
            share = 1.0 - exp(-channel.dt / self._config.filter_s)
            limit = self._config.limit
            self._nu = (self._nu + share * (channel.residual_raw - self._nu)).clip(-limit, limit)
        telemetry.adaptive_now[:] = self._nu
        return self._nu

    def reset(self) -> None:
        """Filter to zero."""
        self._nu = np.zeros(3)
