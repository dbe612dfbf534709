"""The interface of an adaptation law: it estimates the disturbance Delta of one channel as nu_ad.

The cascade (gains, feed-forward, limits, mixer, hedging) is the same for all controllers. They differ in the law only.
The cascade subtracts nu_ad from the demand u.
"""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from onboard.control.records import ChannelTelemetry
from protocol.conventions import Array


@dataclass(slots=True)
class ChannelState:
    """Inputs of a law in one tick. The arrays are rewritten in the next tick."""

    dt: float = 0.0
    """s."""
    adapt: bool = False
    """False: change no adaptive state."""
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
    lap_phase: float = -1.0
    """Share of the lap flown, in [0, 1); negative while the path does not repeat."""
    lap_s: float = 0.0
    """Duration of a lap, s."""
    signals: Array = field(default_factory=lambda: np.zeros((0, 2)))
    """[SIGNAL_COUNT, 2]: signals at the present, and predicted for t_ahead later.

    [SIGNAL_COUNT, 3] for a law that reads its map on the path: at the present, on the path t_ahead from now, and on the
    path now.
    """


class Augmentation(Protocol):
    """Estimates Delta of one channel."""

    def step(self, channel: ChannelState, telemetry: ChannelTelemetry) -> Array:
        """Returns nu_ad [3], units of u, and fills the telemetry."""

    def reset(self) -> None:
        """Reset integrals and filters. What was learnt stays."""
