"""What the controllers differ in: how each estimates the disturbance Delta of a channel, as nu_ad.

The cascade (gains, feed-forward, limits, mixer, hedging) is the same for all; an augmentation only answers with nu_ad,
which is subtracted from the demand u.
"""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from onboard.control.records import ChannelTelemetry
from protocol.conventions import Array


@dataclass(slots=True)
class ChannelState:
    """One channel in one step, as an augmentation sees it. Arrays are rewritten every step."""

    dt: float = 0.0
    """s."""
    adapt: bool = False
    """False: hold still."""
    saturated: bool = False
    """Whether the motors could not meet the last command."""
    tracking_error: Array = field(default_factory=lambda: np.zeros(6))
    """Target minus state; m, m/s or rad, rad/s."""
    model_error: Array = field(default_factory=lambda: np.zeros(6))
    """e = x_rm - x against the hedged reference model."""
    rate: Array = field(default_factory=lambda: np.zeros(3))
    """Second half of x: velocity [m/s] or body rates [rad/s]."""
    u_hat: Array = field(default_factory=lambda: np.zeros(3))
    """What the actuators deliver: m/s^2 or rad/s^2."""
    residual: Array = field(default_factory=lambda: np.zeros(3))
    """x_dot - A x - B u_hat, unfiltered."""
    signals: Array = field(default_factory=lambda: np.zeros((0, 2)))
    """[SIGNAL_COUNT, 2]: columns at the present and where the vehicle will be t_ahead from now."""


class Augmentation(Protocol):
    """Estimates Delta of one channel."""

    def step(self, channel: ChannelState, telemetry: ChannelTelemetry) -> Array:
        """nu_ad [3] for this step, units of u; writes what it knows into the telemetry."""

    def reset(self) -> None:
        """Forgets integrals and filters (not what was learnt)."""
