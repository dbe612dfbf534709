"""Iterative learning control (ILC) on top of INDI: a correction over the lap, updated once per lap.

    nu_ad   = T(theta) + F(r),    F: first-order filter of INDI, r: the residual x_dot - u_hat
    T      <- Q (T - learning L e),    e: tracking error of the whole lap, by lap phase

The error of a channel obeys e_ddot + K_2 e_dot + K_1 e = nu_ad - Delta. So the learning filter L is the left side,
moved ahead by the lag of the loop, and the smoothing filter Q is a Gaussian low-pass without phase. A lap is periodic,
so both are factors of its Fourier coefficients:

    L(omega) = (K_1 + j omega K_2 - omega^2) e^(j omega lead),    Q(omega) = e^(-(omega / cutoff)^2 / 2)

While the path does not repeat, T fades out with the time constant of F, and the law is INDI (laws/indi.py) alone.
Overview: Bristow, Tharayil, Alleyne 2006, "A survey of iterative learning control".
"""

from math import pi
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from onboard.control.laws.indi import IncrementalFilter
from onboard.control.laws.lap_table import LapConfig, LapTable
from onboard.control.laws.law import ChannelState
from onboard.control.records import ChannelTelemetry
from onboard.control.reference_model import ChannelGains
from protocol.conventions import Array


class IterativeLearningConfig(LapConfig):
    """Settings of iterative learning control."""

    kind: Literal["ilc"]
    learning: Annotated[float, Field(gt=0, le=1, description="share of the misfit that a lap corrects")]
    cutoff_hz: Annotated[float, Field(gt=0, le=50, description="of the smoothing filter Q")]


class IterativeLearning:
    """INDI with a correction over the lap that each complete lap improves."""

    def __init__(self, config: IterativeLearningConfig, gains: ChannelGains) -> None:
        self._config = config
        self._K_1, self._K_2 = gains.stiffness(), gains.rate_gain()
        self.table = LapTable(config.bins, config.filter_s)
        self.laps = 0
        """Laps that the table has learnt from."""
        self._sums: Array = np.zeros((config.bins, 3))
        self._counts = np.zeros(config.bins, dtype=int)
        self._last_phase = -1.0
        self._rest = IncrementalFilter(config)
        self._nu: Array = np.zeros(3)

    def step(self, channel: ChannelState, telemetry: ChannelTelemetry) -> Array:
        """Record the tracking error, read the table, filter the residual; returns nu_ad."""
        if channel.adapt:
            limit = self._config.limit
            self._record(channel)
            self.table.follow(channel.lap_phase, channel.dt)
            rest = self._rest.step(channel.residual, channel.dt)
            self._nu = (self.table.ahead(0.0) + rest).clip(-limit, limit)
        telemetry.adaptive_now[:] = self._nu
        return self._nu

    def _record(self, channel: ChannelState) -> None:
        """Add the tracking error to its bin; learn when a lap is complete, discard a lap with a gap."""
        phase = channel.lap_phase
        if phase < self._last_phase:
            if phase >= 0.0 and self._counts.all():
                self._learn(channel.lap_s)
            self._sums[:], self._counts[:] = 0.0, 0
        self._last_phase = phase
        if phase >= 0.0:
            at = self.table.bin(phase)
            self._sums[at] += channel.tracking_error[:3]
            self._counts[at] += 1

    def _learn(self, lap_s: float) -> None:
        """T <- Q (T - learning L e)."""
        config, values = self._config, self.table.values
        omega = (2.0 * pi / lap_s) * np.arange(config.bins // 2 + 1)[:, None]
        L = (self._K_1 + 1j * omega * self._K_2 - omega**2) * np.exp(1j * omega * config.lead_s)
        Q = np.exp(-0.5 * (omega / (2.0 * pi * config.cutoff_hz)) ** 2)
        e = np.fft.rfft(self._sums / self._counts[:, None], axis=0)
        learnt = Q * (np.fft.rfft(values, axis=0) - config.learning * L * e)
        values[:] = np.fft.irfft(learnt, config.bins, axis=0).clip(-config.limit, config.limit)
        self.laps += 1

    def reset(self) -> None:
        """Set the filter to zero and discard the present lap. The table stays."""
        self.table.reset()
        self._sums[:], self._counts[:] = 0.0, 0
        self._last_phase = -1.0
        self._rest.reset()
        self._nu = np.zeros(3)
