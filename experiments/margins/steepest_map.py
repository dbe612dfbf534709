"""Margins of the position loop with the steepest map that the guard accepts (onboard/control/slope.py).

A map over place and velocity is feedback by the share that its gap leaves (experiments/margins/kalman.py): the position
map by K_1 and K_2, and the attitude map as well, because nu / K_1 of the attitude is a tilt.
"""

from collections.abc import Iterator
from typing import NamedTuple

from experiments.flights.scenario import FlightConfig
from experiments.margins.kalman import slope_fed_back
from experiments.margins.linear import LinearModel
from experiments.margins.stability import Margins, margins
from onboard.control.cascade import CascadeSettings
from onboard.control.laws.adaptive import AdaptiveConfig
from onboard.control.laws.kalman_last_layer import KalmanConfig
from protocol.conventions import Array


class Steep(NamedTuple):
    """The position loop of one axis with one map."""

    channel: int
    """Of the map: 0 position, 1 attitude."""
    over: str
    """place or motion: what the map has its slope in."""
    axis: int
    margins: Margins


def steepest_map_margins(config: FlightConfig, omega: Array, times: float = 1.0) -> Iterator[Steep]:
    """Yield the margins with a map at `times` its limit, upwards and downwards; nothing for a law without covariance.

    omega: [n], rad/s, ascending.
    """
    settings = config.onboard.controller.filled_settings(config.onboard.features)
    if not isinstance(settings, CascadeSettings):
        return
    s, model, position = 1j * omega, LinearModel(config, omega), settings.position.gains
    for channel, one in enumerate((settings.position, settings.attitude)):
        augmentation = one.augmentation
        if not isinstance(augmentation, AdaptiveConfig) or not isinstance(augmentation.law, KalmanConfig):
            continue
        shares, law = augmentation.slope_shares, augmentation.law
        for axis in range(3 if channel == 0 else 2):
            k1, k2 = position.stiffness()[axis], position.rate_gain()[axis]
            tilts = 1 - axis if channel else axis  # the axis of the attitude that turns the thrust to north, to east
            fed_back = slope_fed_back(law, augmentation.error_weight, one.gains, tilts, s)
            for over, slope in (("place", shares.place * k1), ("motion", shares.motion * k2 * s)):
                for sign in (-times, times):
                    found = margins(omega, model.loop(0, axis, sign * fed_back * slope).L)
                    yield Steep(channel, over, axis, found)
