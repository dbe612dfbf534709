"""The slope of a map theta'Phi, and its limits by the loop's own gains.

A map over the state is feedback: nu = theta'Phi(p, v, ...) adds d nu/dp to the stiffness of the loop and d nu/dv to its
damping, with either sign. So the slope of each axis is limited to a share of what the loop itself has there:

| channel | input | gain of the loop |
|---|---|---|
| position | position; velocity, also in body axes | K_1, K_2 of the position channel |
| attitude | roll, pitch, yaw; body rates | K_1, K_2 of the attitude channel |
| attitude | position; velocity | K_1 of both channels / g; K_1 K_2 / g |

The last line: nu tilts the vehicle by nu / K_1, and g turns the tilt into acceleration. An input of another kind (motor
thrusts, battery) is not bounded: what nu does to it is not in the loop's gains.

Law (2a) reads position and velocity on the path (onboard.control.laws.kalman_last_layer). There only a rest of the
slope is fed back, and a map may be several times as steep as the loop is stiff
(`test_the_margins_of_dmrac_hold_with_the_steepest_map_that_is_accepted`): the edge of a jet of air is.
"""

from dataclasses import dataclass
from typing import Annotated, Final

import numpy as np
from pydantic import Field

from configs.loader import ConfigRecord
from onboard.control.features import INPUT_LIMIT
from onboard.control.reference_model import ChannelGains
from protocol.conventions import GRAVITY, Array
from protocol.feature_config import ChannelName
from protocol.feature_set import ChannelFeatures
from protocol.signals import input_indices

PLACE: Final = ("position_n", "position_e", "position_d")
MOTION: Final = ("velocity_n", "velocity_e", "velocity_d")
BODY_MOTION: Final = ("body_velocity_x", "body_velocity_y", "body_velocity_z")
ANGLES: Final = ("roll", "pitch", "yaw")
RATES: Final = ("rate_p", "rate_q", "rate_r")


Share = Annotated[float, Field(gt=0, le=1e6)]


class SlopeShares(ConfigRecord):
    """Largest slope of a map, as a share of the loop's own gain. Large: ablation."""

    place: Annotated[Share, Field(description="over the position")] = 5.0
    motion: Annotated[Share, Field(description="over the velocity, also in body axes")] = 1.0
    turn: Annotated[Share, Field(description="over attitude and body rates, which are read at the vehicle")] = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class SlopeLimits:
    """The largest slope of a map, per kind of input."""

    groups: tuple[tuple[tuple[str, ...], Array], ...]
    """Names of the inputs of a kind, and the limit of each axis, [3], units of u per unit of the input."""

    @staticmethod
    def of(channel: ChannelName, position: ChannelGains, attitude: ChannelGains, shares: SlopeShares) -> "SlopeLimits":
        """The shares of the table at the head of this file."""
        stiffness, rate = position.stiffness(), position.rate_gain()
        angles: tuple[tuple[tuple[str, ...], Array], ...] = ()
        if channel == "attitude":
            turn = attitude.stiffness()
            angles = (ANGLES, shares.turn * turn), (RATES, shares.turn * attitude.rate_gain())
            # Roll moves the vehicle east and pitch north; yaw gets the gains of the vertical axis.
            stiffness, rate = turn * stiffness[[1, 0, 2]] / GRAVITY, turn * rate[[1, 0, 2]] / GRAVITY
        motion = shares.motion * rate
        return SlopeLimits((*angles, (PLACE, shares.place * stiffness), (MOTION, motion), (BODY_MOTION, motion)))


def slopes(channel: ChannelFeatures, theta: Array, signals: Array) -> Array:
    """d(theta'Phi)/dx [n, 3, m] at the signal vectors [SIGNAL_COUNT, n], x the m inputs in their own units.

    Zero in an input that is clipped.
    """
    z = (signals[list(input_indices(channel.inputs, channel.signals))].T - channel.offset) / channel.scale
    inside = np.abs(z) < INPUT_LIMIT
    levels = [np.clip(z, -INPUT_LIMIT, INPUT_LIMIT)]
    for W, b in zip(channel.weights, channel.biases, strict=True):
        levels.append(np.tanh(levels[-1] @ W.T + b))
    slope = theta[:-1].T[None] * (1.0 - levels[-1] ** 2)[:, None, :]
    for W, below in zip(reversed(channel.weights[1:]), reversed(levels[1:-1]), strict=True):
        slope = (slope @ W) * (1.0 - below**2)[:, None, :]
    result: Array = (slope @ channel.weights[0]) * (inside / channel.scale)[:, None, :]
    return result


def largest_shares(channel: ChannelFeatures, theta: Array, limits: SlopeLimits, signals: Array) -> Array:
    """[3]: of each axis, the largest slope over the states and the kinds of input, as a share of its limit.

    The slope over the inputs of a kind is the norm of its row, so that what couples the axes counts as well.
    """
    found = np.zeros(theta.shape[1])
    if signals.shape[1] == 0:
        return found
    slope = slopes(channel, theta, signals)
    for names, limit in limits.groups:
        columns = [channel.inputs.index(name) for name in names if name in channel.inputs]
        if columns:
            found = np.maximum(found, np.linalg.norm(slope[:, :, columns], axis=2).max(axis=0) / limit)
    return found


def flattened(theta: Array, shares: Array, Phi: Array) -> tuple[Array, Array]:
    """theta [k, 3] with the slope of every axis within its limit, and the factor of each axis, [3].

    An axis with too steep a map is flattened about its mean over the states: its rows but that of the constant are
    scaled, and the constant takes up the change of the mean.

    Parameters
    ----------
    shares: [3], the largest slope of each axis (`largest_shares`).
    Phi: [k, n], features of the same states.
    """
    factor = 1.0 / np.maximum(shares, 1.0)
    if (factor == 1.0).all():
        return theta, factor
    flat = theta.copy()
    flat[:-1] *= factor
    flat[-1] += (1.0 - factor) * (theta[:-1].T @ Phi[:-1].mean(axis=1))
    return flat, factor
