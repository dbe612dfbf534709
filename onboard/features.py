"""Features Phi(x, c): what the last layer weighs. Learnt network, radial basis functions, or the bias alone.

All kinds share one interface: `select` picks and scales the inputs from the signal vector, `evaluate` maps columns
of scaled inputs to columns of features. The last feature is always the constant 1. Evaluating the present state and
the look-ahead state together costs little more than one of them, so columns are the rule.
"""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from protocol.feature_set import ChannelFeatures
from protocol.signals import input_indices

Array = NDArray[np.float64]

RBF_COUNT = 20
INPUT_LIMIT = 3.0
"""Scaled inputs are clipped here: beyond it nothing was learnt, and the features are not to extrapolate."""


class Features(Protocol):
    """Phi of one channel."""

    feature_count: int
    lipschitz: float
    """Lipschitz constant of Phi in the scaled inputs."""

    def select(self, signals: Array) -> Array:
        """Scaled inputs z of signal vectors: [SIGNAL_COUNT] or [SIGNAL_COUNT, n] to [m] or [m, n]."""

    def evaluate(self, z: Array) -> Array:
        """Phi of scaled inputs: [m, n] to [k, n]."""


class _Selection:
    """Which signals a network sees, and their scaling to about unit size."""

    def __init__(self, inputs: tuple[str, ...], offset: Array, scale: Array) -> None:
        self._indices = np.array(input_indices(inputs), dtype=np.intp)
        self._offset = offset
        self._inverse = 1.0 / scale
        self._offset_column = offset[:, None]
        self._inverse_column = self._inverse[:, None]

    def select(self, signals: Array) -> Array:
        """Z = (x - offset) / scale, clipped to +-INPUT_LIMIT."""
        z: Array = signals.take(self._indices, axis=0)
        one = signals.ndim == 1
        z -= self._offset if one else self._offset_column
        z *= self._inverse if one else self._inverse_column
        return np.minimum(np.maximum(z, -INPUT_LIMIT, out=z), INPUT_LIMIT, out=z)


class NetworkFeatures(_Selection):
    """Inner layers of a trained network: tanh layers, then the constant 1."""

    def __init__(self, channel: ChannelFeatures) -> None:
        super().__init__(channel.inputs, channel.offset, channel.scale)
        # [W, b] with a row of ones below the layer's input: one product less a layer, into arrays that are kept.
        self._layers = [
            np.ascontiguousarray(np.hstack([W, b[:, None]]))
            for W, b in zip(channel.weights, channel.biases, strict=True)
        ]
        self._work: list[Array] = []
        self.feature_count = channel.feature_count
        self.lipschitz = channel.lipschitz_bound()

    def evaluate(self, z: Array) -> Array:
        """Phi = [tanh(W_L ... tanh(W_1 z + b_1) + b_L); 1]."""
        n = z.shape[1]
        if not self._work or self._work[0].shape[1] != n:
            self._work = [np.ones((layer.shape[1], n)) for layer in self._layers]
        Phi = np.empty((self.feature_count, n))
        h = self._work[0]
        h[:-1] = z
        for layer, above in zip(self._layers, (*self._work[1:], Phi), strict=True):
            inner = above[:-1]
            np.dot(layer, h, out=inner)
            np.tanh(inner, out=inner)
            h = above
        Phi[-1] = 1.0
        return Phi


class RadialFeatures(_Selection):
    """Gaussian radial basis functions on a fixed low-discrepancy grid over the unit box, then the constant 1."""

    def __init__(
        self, inputs: tuple[str, ...], offset: Array, scale: Array, width: float, count: int = RBF_COUNT
    ) -> None:
        """width: of the Gaussians, in scaled units, for one input; it grows with sqrt(m) to keep them overlapping."""
        super().__init__(inputs, offset, scale)
        m = len(inputs)
        self._centres = 2.0 * halton(count, m) - 1.0
        self._centre_norms = (self._centres**2).sum(axis=1)[:, None]
        self._inverse_width2 = 1.0 / (2.0 * width * width * m)
        self.feature_count = count + 1
        # |d phi/dz| <= exp(-1/2) / width for each Gaussian; the norm over all of them is at most sqrt(count) times it.
        self.lipschitz = float(np.exp(-0.5) / (width * m**0.5) * count**0.5)

    def evaluate(self, z: Array) -> Array:
        """phi_i = exp(-|z - c_i|^2 / (2 width^2 m)); then 1."""
        distance2 = self._centre_norms + (z * z).sum(axis=0) - 2.0 * np.dot(self._centres, z)
        Phi = np.empty((self.feature_count, z.shape[1]))
        np.exp(-self._inverse_width2 * distance2, out=Phi[:-1])
        Phi[-1] = 1.0
        return Phi


class BiasFeatures:
    """The constant 1 alone: adaptive bias, that is, an integrator with the same law and bandwidth."""

    feature_count = 1
    lipschitz = 0.0

    def select(self, signals: Array) -> Array:
        """No inputs."""
        return np.zeros((0, *signals.shape[1:]))

    def evaluate(self, z: Array) -> Array:
        """Phi = 1."""
        return np.ones((1, z.shape[1]))


def halton(count: int, dimensions: int) -> Array:
    """[count, dimensions] points of the Halton sequence in the unit cube (Halton 1960), bases the first primes.

    Raises ValueError for more than 24 dimensions.
    """
    primes = (2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37, 41, 43, 47, 53, 59, 61, 67, 71, 73, 79, 83, 89)
    if dimensions > len(primes):
        raise ValueError(f"{dimensions} dimensions, at most {len(primes)}")
    points = np.empty((count, dimensions))
    for column, base in enumerate(primes[:dimensions]):
        for row in range(count):
            value, fraction, index = 0.0, 1.0, row + 1
            while index > 0:
                fraction /= base
                index, digit = divmod(index, base)
                value += fraction * digit
            points[row, column] = value
    return points


def random_channel(
    inputs: tuple[str, ...], offset: Array, scale: Array, widths: tuple[int, ...], rng: np.random.Generator
) -> ChannelFeatures:
    """The features a flight starts with before anything was learnt: Xavier-normal inner layers, last layer zero.

    widths: outputs of each inner layer, the constant feature not counted.
    """
    weights, biases = [], []
    fan_in = len(inputs)
    for width in widths:
        weights.append(rng.normal(0.0, (2.0 / (fan_in + width)) ** 0.5, (width, fan_in)))
        biases.append(rng.uniform(-0.5, 0.5, width))
        fan_in = width
    return ChannelFeatures(inputs, offset, scale, tuple(weights), tuple(biases), np.zeros((fan_in + 1, 3)))
