"""L1 adaptive augmentation with the piecewise-constant law (Xargay, Hovakimyan, Cao 2010)."""

from math import exp
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from configs.loader import ConfigRecord
from onboard.control.laws.law import ChannelState
from onboard.control.records import ChannelTelemetry
from protocol.conventions import Array


class L1Config(ConfigRecord):
    """Settings of the L1 law."""

    kind: Literal["l1"]
    predictor_pole_rad_s: Annotated[float, Field(gt=0, le=200, description="-A_s of the state predictor")]
    bandwidth_rad_s: Annotated[float, Field(gt=0, le=200, description="of the low-pass filter C(s)")]
    limit: Annotated[float, Field(gt=0, description="bound on each axis of nu_ad, units of u")]


class L1:
    """State predictor on the rate of the channel; sigma_hat makes its prediction error decay.

    v_hat_dot = u_hat + sigma_hat - a (v_hat - v); sigma_hat = -[a / (e^{a T} - 1)] (v_hat - v); nu_ad = C(s) sigma_hat.
    (With A_s = -a: Phi = A_s^-1 (e^{A_s T} - I), sigma_hat = -Phi^-1 e^{A_s T} v_tilde.)
    """

    def __init__(self, config: L1Config) -> None:
        self._config = config
        self._started = False
        self._rate: Array = np.zeros(3)
        self._error: Array = np.zeros(3)
        self._sigma: Array = np.zeros(3)
        self._nu: Array = np.zeros(3)

    def step(self, channel: ChannelState, telemetry: ChannelTelemetry) -> Array:
        """One step of predictor, piecewise-constant law and filter; returns nu_ad."""
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
            # Exact for u_hat and sigma_hat constant since the last step: v_tilde decays, the rest integrates. u_hat and
            # the length of the step are known only now.
            prediction = self._rate + decay * self._error + ((1.0 - decay) / a) * self._sigma
            error = prediction + T * channel.u_hat - channel.rate
            self._sigma = -(a * decay / (1.0 - decay)) * error
        self._rate, self._error = channel.rate.copy(), error
        share = 1.0 - exp(-self._config.bandwidth_rad_s * T)
        limit = self._config.limit
        self._nu = (self._nu + share * (self._sigma - self._nu)).clip(-limit, limit)

    def reset(self) -> None:
        """Reset predictor and filter."""
        self._started = False
        self._sigma = np.zeros(3)
        self._nu = np.zeros(3)
