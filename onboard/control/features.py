"""Features Phi(x, c), the inputs of the last layer: a learnt network, radial basis functions, or the bias alone.

All kinds have one interface. `select` takes the inputs from the signal vector and scales them; `evaluate` maps columns
of scaled inputs to columns of features. The last feature is always the constant 1. The present state and the look-ahead
state are evaluated together, as two columns, which costs little more than one.
"""

from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from protocol.conventions import Array
from protocol.feature_set import ChannelFeatures
from protocol.signals import SIGNAL_NAMES, input_indices

RBF_COUNT = 20
INPUT_LIMIT = 3.0
"""Scaled inputs are clipped to +- this value, so that the features do not extrapolate."""


Indices = NDArray[np.intp]


class Features(Protocol):
    """Phi of one channel."""

    feature_count: int
    inputs: tuple[str, ...]
    """Names of the signals that it sees."""

    @property
    def lipschitz(self) -> float:
        """Lipschitz constant of Phi in the scaled inputs."""

    def select(self, signals: Array) -> Array:
        """Scaled inputs z of signal vectors: [SIGNAL_COUNT] or [SIGNAL_COUNT, n] to [m] or [m, n]."""

    def evaluate(self, z: Array) -> Array:
        """Phi of scaled inputs: [m, n] to [k, n]."""

    def slope(self, column: int, inputs: Indices) -> Array:
        """dPhi/dx [k - 1, n], without the constant, over n of the inputs, in their units, at a column last evaluated.

        Zero in an input that is clipped.
        """


class _Selection:
    """Selects the inputs from the signal vector and scales them to about unit size."""

    def __init__(
        self, inputs: tuple[str, ...], offset: Array, scale: Array, signals: tuple[str, ...] = SIGNAL_NAMES
    ) -> None:
        """signals: names of the elements of a signal vector."""
        self.inputs = inputs
        self._indices = np.array(input_indices(inputs, signals), dtype=np.intp)
        self._offset = offset
        self._inverse = 1.0 / scale
        self._full = self._repeated(2)

    def select(self, signals: Array) -> Array:
        """z = (x - offset) / scale, clipped to +-INPUT_LIMIT."""
        z: Array = signals.take(self._indices, axis=0)
        columns = z if z.ndim == 2 else z[:, None]
        if columns.shape != self._full[0].shape:
            self._full = self._repeated(columns.shape[1])
        offset, inverse, limit, negative_limit = self._full
        columns -= offset
        columns *= inverse
        np.minimum(columns, limit, out=columns)
        np.maximum(columns, negative_limit, out=columns)
        return z

    def _repeated(self, columns: int) -> tuple[Array, Array, Array, Array]:
        """Offset, 1 / scale and the limits as [m, columns]: numpy is fastest with operands of one shape."""
        shape = (len(self._indices), columns)
        offset, inverse = (np.repeat(vector[:, None], columns, axis=1) for vector in (self._offset, self._inverse))
        return offset, inverse, np.full(shape, INPUT_LIMIT), np.full(shape, -INPUT_LIMIT)

    def _slope_of_first(self, first: Array, z: list[float], inputs: Indices) -> Array:
        """first / scale [h, n], of first [h, m] in scaled inputs; zero where z [n] is clipped."""
        slope: Array = first.take(inputs, axis=1) * self._inverse.take(inputs)
        if max(z) >= INPUT_LIMIT or min(z) <= -INPUT_LIMIT:
            slope *= np.abs(z) < INPUT_LIMIT
        return slope


class NetworkFeatures(_Selection):
    """Inner layers of a trained network: tanh layers, then the constant 1."""

    def __init__(self, channel: ChannelFeatures) -> None:
        super().__init__(channel.inputs, channel.offset, channel.scale, channel.signals)
        self.channel = channel
        # [W, b], with a row of ones below the input of the layer: one product per layer, into preallocated arrays.
        self._layers = [
            np.ascontiguousarray(np.hstack([W, b[:, None]]))
            for W, b in zip(channel.weights, channel.biases, strict=True)
        ]
        self._prepare(2)
        self.feature_count = channel.feature_count

    @property
    def lipschitz(self) -> float:
        """Lipschitz constant of Phi in the scaled inputs."""
        return self.channel.lipschitz_bound()

    def _prepare(self, columns: int) -> None:
        """Allocate the arrays for this number of columns: the inputs of each layer with a row of ones, and Phi."""
        heights = [layer.shape[1] for layer in self._layers] + [self._layers[-1].shape[0] + 1]
        levels = [np.ones((height, columns)) for height in heights]
        self._inputs, self._Phi = levels[0][:-1], levels[-1]
        self._passes = [
            (layer, below, above[:-1]) for layer, below, above in zip(self._layers, levels, levels[1:], strict=False)
        ]

    def evaluate(self, z: Array) -> Array:
        """Phi = [tanh(W_L ... tanh(W_1 z + b_1) + b_L); 1]."""
        if z.shape != self._inputs.shape:
            self._prepare(z.shape[1])
        self._inputs[:] = z
        for layer, below, above in self._passes:
            np.dot(layer, below, out=above)
            np.tanh(above, out=above)
        return self._Phi.copy()

    def slope(self, column: int, inputs: Indices) -> Array:
        """dPhi/dx = D_L W_L ... D_1 W_1 dz/dx with D_i = diag(1 - h_i^2), h_i the outputs of layer i."""
        z, (first, *inner) = self._inputs[:, column].take(inputs).tolist(), self.channel.weights
        J = self._slope_of_first(first, z, inputs)
        for W, (_, _, above) in zip((None, *inner), self._passes, strict=True):
            h = above[:, column]
            if W is not None:
                J = np.dot(W, J)
            J *= (1.0 - h * h)[:, None]
        return J


class RadialFeatures(_Selection):
    """Gaussian radial basis functions on a fixed low-discrepancy grid over the unit box, then the constant 1."""

    def __init__(
        self, inputs: tuple[str, ...], offset: Array, scale: Array, width: float, count: int = RBF_COUNT
    ) -> None:
        """width: of the Gaussians, in scaled units, for one input; it grows with sqrt(m) to keep them overlapping."""
        super().__init__(inputs, offset, scale)
        m = len(inputs)
        centres = 2.0 * halton(count, m) - 1.0
        # The exponent is linear in [z; z^2; 1].
        parts = (2.0 * centres, -np.ones((count, m)), -(centres**2).sum(axis=1)[:, None])
        self._exponent = np.hstack(parts) / (2.0 * width * width * m)
        self._curvature = 1.0 / (width * width * m)
        self._centres = centres
        self._rows = (2 * m + 1, count + 1)
        self._prepare(2)
        self.feature_count = count + 1
        # |d phi/dz| <= exp(-1/2) / width for each Gaussian; the norm over all of them is at most sqrt(count) times it.
        self.lipschitz = float(np.exp(-0.5) / (width * m**0.5) * count**0.5)

    def evaluate(self, z: Array) -> Array:
        """phi_i = exp(-|z - c_i|^2 / (2 width^2 m)); then 1."""
        m, n = z.shape
        if n != self._Phi.shape[1]:
            self._prepare(n)
        work, exponents = self._work, self._Phi[:-1]
        work[:m] = z
        np.multiply(z, z, out=work[m:-1])
        np.dot(self._exponent, work, out=exponents)
        np.exp(exponents, out=exponents)
        return self._Phi.copy()

    def slope(self, column: int, inputs: Indices) -> Array:
        """dphi_i/dx = (c_i - z)' / (width^2 m) phi_i dz/dx."""
        z = self._work[: len(self.inputs), column]
        towards = self._curvature * self._Phi[:-1, column, None] * (self._centres - z)
        return self._slope_of_first(towards, z.take(inputs).tolist(), inputs)

    def _prepare(self, columns: int) -> None:
        """Allocate the arrays for this number of columns: [z; z^2; 1] and Phi."""
        self._work, self._Phi = (np.ones((rows, columns)) for rows in self._rows)


class BiasFeatures:
    """The constant 1 alone. W is then an adaptive bias: an integrator with the same law and bandwidth."""

    feature_count = 1
    lipschitz = 0.0
    inputs: tuple[str, ...] = ()

    def select(self, signals: Array) -> Array:
        """Returns no inputs: [0] or [0, n]."""
        return np.zeros((0, *signals.shape[1:]))

    def evaluate(self, z: Array) -> Array:
        """Phi = 1."""
        return np.ones((1, z.shape[1]))

    def slope(self, column: int, inputs: Indices) -> Array:
        """Returns no slope: [0, n]."""
        del column
        return np.zeros((0, inputs.size))


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
    """Random features for the start of a flight: Xavier-normal inner layers, last layer zero.

    widths: outputs of each inner layer, the constant feature not counted.
    """
    weights, biases = [], []
    fan_in = len(inputs)
    for width in widths:
        weights.append(rng.normal(0.0, (2.0 / (fan_in + width)) ** 0.5, (width, fan_in)))
        biases.append(rng.uniform(-0.5, 0.5, width))
        fan_in = width
    return ChannelFeatures(inputs, offset, scale, tuple(weights), tuple(biases), np.zeros((fan_in + 1, 3)))


def silenced(channel: ChannelFeatures) -> ChannelFeatures:
    """The same widths, with a last inner layer of zeros: of all features only the constant 1 is left.

    A law that shares its gain between untrained features and the constant learns along random functions of the state.
    It follows the uncertainty no better, and their slope feeds back (docs/theory_covariance.md).
    """
    *weights, W = channel.weights
    *biases, b = channel.biases
    return replace(channel, weights=(*weights, np.zeros_like(W)), biases=(*biases, np.zeros_like(b)))
