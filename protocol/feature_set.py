"""A version of the learnt features: the shape of the networks, as both sides use it.

Phi(x) = [tanh(W_L ... tanh(W_1 z + b_1) ... + b_L); 1] with z = (x - offset) / scale, and
nu_ad = last_layer' Phi(x). The constant 1 is the bias feature.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from protocol.conventions import Array
from protocol.messages import VERSION_MAX
from protocol.signals import SIGNAL_NAMES, input_indices

LAYERS_MAX: Final = 4
WIDTH_MAX: Final = 128
AXES: Final = 3
"""Outputs of a channel of the vehicle."""


@dataclass(frozen=True, slots=True, eq=False)
class ChannelFeatures:
    """Features of one adaptive channel: m inputs, k features (the constant included), q outputs.

    A channel of the vehicle has 3 outputs, and inputs among the signals of the vehicle; other learners may have others.

    Raises ValueError on construction if shapes do not fit, a name is unknown or a value is not finite.
    """

    inputs: tuple[str, ...]
    """Signal names of the inputs."""
    offset: Array
    """[m], in the inputs' units."""
    scale: Array
    """[m], in the inputs' units, all positive."""
    weights: tuple[Array, ...]
    """Inner layers W_i, [out, in] each."""
    biases: tuple[Array, ...]
    """b_i, [out] each."""
    last_layer: Array
    """[k, q]: the trained last layer theta_n, in units of the channel's u."""
    signals: tuple[str, ...] = SIGNAL_NAMES
    """Names of the elements of a signal vector."""

    def __post_init__(self) -> None:
        input_indices(self.inputs, self.signals)
        m = len(self.inputs)
        if not 1 <= len(self.weights) == len(self.biases) <= LAYERS_MAX:
            raise ValueError(f"{len(self.weights)} layers with {len(self.biases)} biases, allowed 1 to {LAYERS_MAX}")
        if self.offset.shape != (m,) or self.scale.shape != (m,):
            raise ValueError(f"offset {self.offset.shape} and scale {self.scale.shape}, expected ({m},)")
        width = m
        for W, b in zip(self.weights, self.biases, strict=True):
            if W.ndim != 2 or W.shape[1] != width or b.shape != W.shape[:1] or not 1 <= W.shape[0] <= WIDTH_MAX:
                raise ValueError(f"layer of shape {W.shape} with bias {b.shape} after width {width}")
            width = W.shape[0]
        if self.last_layer.ndim != 2 or self.last_layer.shape[0] != width + 1 or self.last_layer.shape[1] < 1:
            raise ValueError(f"last_layer of shape {self.last_layer.shape}, expected {width + 1} rows")
        if not all(bool(np.isfinite(array).all()) for array in (self.offset, self.scale, *self.parameters)):
            raise ValueError("a value is not finite")
        if not bool((self.scale > 0).all()):
            raise ValueError("scale must be positive")

    @property
    def parameters(self) -> tuple[Array, ...]:
        """All trained arrays: W_1 ... W_L, b_1 ... b_L, last_layer."""
        return (*self.weights, *self.biases, self.last_layer)

    @property
    def feature_count(self) -> int:
        """k, the number of features, the constant included."""
        return int(self.last_layer.shape[0])

    def same_as(self, other: "ChannelFeatures") -> bool:
        """Whether the other features are the same to the bit."""
        pairs = zip(
            (self.offset, self.scale, *self.parameters), (other.offset, other.scale, *other.parameters), strict=False
        )
        alike = self.inputs == other.inputs and len(self.parameters) == len(other.parameters)
        return alike and all(np.array_equal(mine, its) for mine, its in pairs)

    def lipschitz_bound(self) -> float:
        """Lipschitz constant of Phi in the scaled inputs z: the product of the spectral norms."""
        return float(np.prod([np.linalg.norm(W, 2) for W in self.weights]))


@dataclass(frozen=True, slots=True, eq=False)
class FeatureSet:
    """One trained version, for one or both channels."""

    version: int
    """From 1, increasing; 0 is reserved for the random start features."""
    parent: int
    """The version it was trained from; 0 for none."""
    samples: int
    """Number of samples that it was trained on."""
    position: ChannelFeatures | None
    attitude: ChannelFeatures | None

    def __post_init__(self) -> None:
        if not (0 <= self.version <= VERSION_MAX and 0 <= self.parent <= VERSION_MAX and self.samples >= 0):
            raise ValueError("version, parent or samples out of range")
        if self.position is None and self.attitude is None:
            raise ValueError("a feature set without any channel")
        for channel in self.channels:
            if channel.last_layer.shape[1] != AXES or channel.signals != SIGNAL_NAMES:
                raise ValueError(f"last_layer of shape {channel.last_layer.shape}, expected {AXES} columns")

    @property
    def by_channel(self) -> tuple[ChannelFeatures | None, ChannelFeatures | None]:
        """Position and attitude channel; None for one that it does not cover."""
        return self.position, self.attitude

    @property
    def channels(self) -> list[ChannelFeatures]:
        """The channels that it covers, position first."""
        return [channel for channel in self.by_channel if channel is not None]
