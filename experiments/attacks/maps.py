"""Feature versions to order: random features, a fit to what was flown, cliffs, and mixtures of single units."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from experiments.attacks.bad_learner import View
from onboard.control.features import random_channel
from protocol.conventions import Array
from protocol.feature_config import ChannelName
from protocol.feature_set import ChannelFeatures
from protocol.signals import input_indices

SHARE: Final = 0.99
"""Of W_max: the largest last layer that is surely accepted."""
STEEPNESS: Final = 190.0
"""Lipschitz constant of a cliff, in scaled inputs; onboard accepts 200."""
RIDGE: Final = 1.0
RECENT: Final = 55
"""Samples of about the last second."""
BISECTIONS: Final = 10


def phi(view: View, channel: ChannelFeatures) -> Array:
    """[n, k], features of all samples."""
    z = (view.signals[:, list(input_indices(channel.inputs))] - channel.offset) / channel.scale
    level = np.clip(z, -3.0, 3.0)
    for W, b in zip(channel.weights, channel.biases, strict=True):
        level = np.tanh(level @ W.T + b)
    return np.hstack([level, np.ones((len(level), 1))])


def untrained(view: View, channel: ChannelName) -> ChannelFeatures:
    """Random inner layers in the trained networks' inputs and widths; theta = 0."""
    networks = view.networks
    names = networks.inputs(channel)
    offset, scale = networks.offset_and_scale(names)
    return random_channel(names, offset, scale, (*networks.hidden, networks.count - 1), view.rng)


def least_squares(view: View, channel: ChannelName, features: ChannelFeatures) -> ChannelFeatures:
    """These inner layers with the last layer of least squares on nu_ad as it flew."""
    Phi, target = phi(view, features), view.adaptive[:, 0 if channel == "position" else 1]
    gram = Phi.T @ Phi + RIDGE * np.eye(Phi.shape[1])
    theta: Array = np.linalg.solve(gram, Phi.T @ target).astype(np.float64)
    return replace(features, last_layer=theta)


def learnt(view: View, channel: ChannelName) -> ChannelFeatures:
    """Random inner layers with the last layer of least squares on nu_ad as it flew: an honest version."""
    return least_squares(view, channel, untrained(view, channel))


def of_norm(theta: Array, norm: float) -> Array:
    """A last layer scaled to this norm; zero stays."""
    size = float(np.linalg.norm(theta))
    return theta * (norm / size) if size > 0.0 else theta


def cliff(
    view: View, channel: ChannelName, signal: str, at: float, side: float, height: float, axis: int, sharp: float
) -> ChannelFeatures:
    """theta'Phi = 0 on one side of a place, and `height` on the other.

    Parameters
    ----------
    signal, at: the input, and its value at the cliff, in its own unit.
    side: 1 if the high side is that of larger values, else -1.
    """
    features = untrained(view, channel)
    column = features.inputs.index(signal)
    W = np.zeros((1, len(features.inputs)))
    W[0, column] = side * sharp
    z = (at - features.offset[column]) / features.scale[column]
    theta = np.zeros((2, 3))
    theta[:, axis] = height / 2.0
    return replace(features, weights=(W,), biases=(np.array([-side * sharp * z]),), last_layer=theta)


def accepted(view: View, name: ChannelName, features: ChannelFeatures, theta: Array) -> ChannelFeatures:
    """The largest multiple of a last layer, up to 1, that the test of onboard accepts now, by bisection."""
    least, most = 0.0, 1.0
    for _ in range(BISECTIONS):
        share = 0.5 * (least + most)
        if view.is_accepted(name, replace(features, last_layer=share * theta)):
            least = share
        else:
            most = share
    return replace(features, last_layer=0.98 * least * theta)


class Units:
    """A network of one layer, put together from single tanh units and a constant."""

    def __init__(self, layout: ChannelFeatures) -> None:
        """layout: its inputs, offset and scale are used."""
        self._layout = layout
        self._weights: list[Array] = []
        self._biases: list[Array] = []
        self._theta: list[Array] = []
        self.constant: Array = np.zeros(3)

    def add(self, W: Array, b: Array, theta: Array) -> None:
        """Units with weights W [u, m] and biases b [u] of the scaled inputs, and their rows theta [u, 3]."""
        self._weights.append(W)
        self._biases.append(b)
        self._theta.append(theta)

    def add_straight(self, names: Sequence[str], now: Array, gentle: float, theta: Array) -> None:
        """One nearly straight unit per input, zero at the signals `now` [SIGNAL_COUNT]; theta per scaled input."""
        columns = [self._layout.inputs.index(name) for name in names]
        z = (now[input_indices(tuple(names))] - self._layout.offset[columns]) / self._layout.scale[columns]
        W = np.zeros((len(columns), len(self._layout.inputs)))
        W[np.arange(len(columns)), columns] = gentle
        self.add(W, -gentle * z, theta / gentle)

    def add_step(self, names: Sequence[str], at: Array, forward: Array, sharp: float, height: Array) -> None:
        """A step of `height` [3] across the direction `forward` at the place `at`, in the inputs `names`."""
        columns = [self._layout.inputs.index(name) for name in names]
        offset, scale = self._layout.offset[columns], self._layout.scale[columns]
        W = np.zeros((1, len(self._layout.inputs)))
        W[0, columns] = sharp * forward
        z = (at - offset) / scale
        self.add(W, np.array([-sharp * float(forward @ z)]), 0.5 * height[None])
        self.constant = self.constant + 0.5 * height

    def features(self) -> ChannelFeatures:
        """The channel, with the constant in the last row of theta."""
        theta = np.vstack([*self._theta, self.constant])
        W, b = np.vstack(self._weights), np.concatenate(self._biases)
        return replace(self._layout, weights=(W,), biases=(b,), last_layer=theta)
