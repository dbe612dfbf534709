"""The feature networks of all channels in one stack of arrays, and their features in numpy.

Phi(x) = [tanh(W_L ... tanh(W_1 z + b_1) ... + b_L); 1] with z = (x - offset) / scale. All channels have the same
layer widths, so that one batched product computes them all; a channel with fewer inputs is padded with zeros.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from protocol.conventions import Array
from protocol.feature_config import TrainedFeatures
from protocol.feature_set import AXES, ChannelFeatures, FeatureSet
from protocol.signals import CHANNELS, SIGNAL_NAMES, input_indices

Array32 = NDArray[np.float32]

SPECTRAL_SLACK: Final = 0.999
"""Factor on the bound in the exact projection, so that rounding to float32 cannot lift a norm above the bound."""

_SINGLE: Final = ("offset", "scale", "last_layer", "last_bias")
"""Arrays of a NetworkState that are one for all layers."""


@dataclass(frozen=True, slots=True, eq=False)
class NetworkState:
    """Parameters of C channels with m (padded) inputs and k features, the constant included."""

    offset: Array32
    """[C, m]"""
    scale: Array32
    """[C, m]"""
    weights: tuple[Array32, ...]
    """W_i' of each inner layer, [C, in, out]."""
    biases: tuple[Array32, ...]
    """b_i, [C, 1, out]."""
    last_layer: Array32
    """theta, [C, k - 1, q], in units of u; q outputs, 3 in a channel of the vehicle."""
    last_bias: Array32
    """theta_0, the row of theta for the constant feature, [C, 1, q]."""

    def named_arrays(self) -> dict[str, Array32]:
        """All arrays by name, for a file; those of a layer have its number in their name."""
        arrays = {name: getattr(self, name) for name in _SINGLE}
        for layer, (W, b) in enumerate(zip(self.weights, self.biases, strict=True)):
            arrays |= {f"weights_{layer}": W, f"biases_{layer}": b}
        return arrays

    @staticmethod
    def from_named_arrays(arrays: Mapping[str, Any], layers: int) -> "NetworkState":
        """The networks with so many inner layers from `named_arrays`. Raises KeyError if one is missing."""
        single = {name: arrays[name] for name in _SINGLE}
        weights, biases = (tuple(arrays[f"{name}_{at}"] for at in range(layers)) for name in ("weights", "biases"))
        return NetworkState(weights=weights, biases=biases, **single)


class NetworkConfig(Protocol):
    """What a round of training must know of the networks: TrainedFeatures for a vehicle, or another learner's own."""

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of the elements of a signal vector."""

    @property
    def all_channels(self) -> tuple[str, ...]:
        """Names of the channels that the labels have."""

    @property
    def outputs(self) -> int:
        """q, of each channel."""

    @property
    def channels(self) -> tuple[str, ...]:
        """The channels that are trained."""

    @property
    def hidden(self) -> tuple[int, ...]:
        """Widths of the hidden layers."""

    @property
    def count(self) -> int:
        """k, features of a channel, the constant included."""

    @property
    def spectral_norm_max(self) -> float:
        """Bound on the largest singular value of each inner layer."""

    @property
    def first_layer_gain(self) -> float:
        """Spread of the random first layer."""

    @property
    def dropout(self) -> float:
        """Share of the features that is dropped in a training step."""

    @property
    def scaling(self) -> str:
        """fixed or data: `offset_and_scale`, or mean and spread of the first training set."""

    def inputs(self, channel: str) -> tuple[str, ...]:
        """Names of a channel's inputs."""

    def offset_and_scale(self, names: tuple[str, ...]) -> tuple[Array, Array]:
        """Offset and scale [m] of the named signals."""


@dataclass(frozen=True, slots=True)
class InputPlan:
    """The inputs and outputs of each channel's features."""

    channels: tuple[int, ...]
    """Indices of the channels that are trained among those of the labels, [C]."""
    names: tuple[tuple[str, ...], ...]
    """Signal names of each channel's inputs."""
    signals: tuple[str, ...] = SIGNAL_NAMES
    """Names of the elements of a signal vector."""
    outputs: int = AXES
    """q, of each channel."""

    @staticmethod
    def of(config: NetworkConfig) -> "InputPlan":
        """The plan of a configuration."""
        every = config.all_channels
        channels = tuple(index for index, name in enumerate(every) if name in config.channels)
        names = tuple(config.inputs(every[index]) for index in channels)
        return InputPlan(channels, names, config.signals, config.outputs)

    @property
    def width(self) -> int:
        """m, the padded number of inputs."""
        return max(len(names) for names in self.names)

    def gather(self, signals: Array32, offset: Array32, scale: Array32) -> Array32:
        """z = (x - offset) / scale, [C, m, n], of signals [n, SIGNAL_COUNT]; the padding is zero."""
        z = np.zeros((len(self.channels), self.width, signals.shape[0]), dtype=np.float32)
        for row, names in enumerate(self.names):
            used = len(names)
            z[row, :used] = (
                (signals[:, input_indices(names, self.signals)] - offset[row, :used]) / scale[row, :used]
            ).T
        return z


def initial_state(config: NetworkConfig, rng: np.random.Generator) -> NetworkState:
    """Random inner layers within the spectral bound, last layer zero."""
    plan = InputPlan.of(config)
    C, m = len(plan.channels), plan.width
    widths = (m, *config.hidden, config.count - 1)
    weights, biases = [], []
    for layer, (fan_in, fan_out) in enumerate(pairwise(widths)):
        W = np.zeros((C, fan_in, fan_out), dtype=np.float32)
        for row, names in enumerate(plan.names):
            used = len(names) if layer == 0 else fan_in
            gain = config.first_layer_gain if layer == 0 else 1.0
            W[row, :used] = rng.normal(0.0, gain / np.sqrt(used), (used, fan_out))
        weights.append(below_bound(W, config.spectral_norm_max))
        biases.append(rng.uniform(-0.5, 0.5, (C, 1, fan_out)).astype(np.float32))
    offset, scale = np.zeros((C, m), dtype=np.float32), np.ones((C, m), dtype=np.float32)
    for row, names in enumerate(plan.names):
        offset[row, : len(names)], scale[row, : len(names)] = config.offset_and_scale(names)
    theta, theta_0 = (np.zeros((C, rows, plan.outputs), dtype=np.float32) for rows in (config.count - 1, 1))
    return NetworkState(offset, scale, tuple(weights), tuple(biases), theta, theta_0)


def scales_from_data(config: NetworkConfig, signals: Array32) -> tuple[Array32, Array32]:
    """Mean, and standard deviation but at least half the fixed scale, of signals [n, SIGNAL_COUNT]; [C, m] each."""
    plan = InputPlan.of(config)
    offset = np.zeros((len(plan.channels), plan.width), dtype=np.float32)
    scale = np.ones_like(offset)
    for row, names in enumerate(plan.names):
        columns = signals[:, input_indices(names, plan.signals)]
        floor = 0.5 * config.offset_and_scale(names)[1]
        offset[row, : len(names)] = columns.mean(axis=0)
        scale[row, : len(names)] = np.maximum(columns.std(axis=0), floor)
    return offset, scale


def below_bound(W: Array32, bound: float) -> Array32:
    """W min(1, bound / sigma_1) of each matrix of the stack [C, in, out], sigma_1 its largest singular value."""
    sigma_1 = largest_singular_values(W)
    shrink = np.minimum(1.0, SPECTRAL_SLACK * bound / np.maximum(sigma_1, 1e-12))
    shrunk: Array32 = (W * shrink[:, None, None]).astype(np.float32)
    return shrunk


def largest_singular_values(W: NDArray[np.floating]) -> Array:
    """sigma_1 of each matrix of the stack [C, in, out]: the root of the largest eigenvalue of W'W.

    A third of the time of a singular value decomposition; its error is the rounding of W'W, 1e-16 sigma_1.
    """
    wide = W.astype(np.float64)
    gram = np.swapaxes(wide, 1, 2) @ wide
    sigma_1: Array = np.sqrt(np.linalg.eigvalsh(gram)[:, -1].clip(min=0.0))
    return sigma_1


def channel_features(state: NetworkState, plan: InputPlan, row: int) -> ChannelFeatures:
    """Channel `row` of the stack as it is sent to onboard."""
    m = len(plan.names[row])
    weights = [W[row].T.astype(np.float64) for W in state.weights]
    weights[0] = weights[0][:, :m].copy()
    return ChannelFeatures(
        inputs=plan.names[row],
        offset=state.offset[row, :m].astype(np.float64),
        scale=state.scale[row, :m].astype(np.float64),
        weights=tuple(weights),
        biases=tuple(b[row, 0].astype(np.float64) for b in state.biases),
        last_layer=np.vstack([state.last_layer[row], state.last_bias[row]]).astype(np.float64),
        signals=plan.signals,
    )


def feature_set(state: NetworkState, plan: InputPlan, version: int, parent: int, samples: int) -> FeatureSet:
    """The networks as a feature version to send."""
    channels = {CHANNELS[at]: channel_features(state, plan, row) for row, at in enumerate(plan.channels)}
    return FeatureSet(version, parent, samples, channels.get("position"), channels.get("attitude"))


def state_of(features: FeatureSet, config: TrainedFeatures) -> NetworkState:
    """The networks of a feature version, to be trained further.

    Raises
    ------
    ValueError
        If its channels, inputs or widths are not those of the configuration.
    """
    plan = InputPlan.of(config)
    state = initial_state(config, np.random.default_rng(0))
    found = [features.by_channel[at] for at in plan.channels]
    for row, channel in enumerate(found):
        m = len(plan.names[row])
        if channel is None or channel.inputs != plan.names[row]:
            raise ValueError(f"features of {CHANNELS[plan.channels[row]]}: not the configured inputs")
        expected = [W.shape[2] for W in state.weights]
        if [W.shape[0] for W in channel.weights] != expected:
            raise ValueError(f"features of {CHANNELS[plan.channels[row]]}: not the configured widths {expected}")
        state.offset[row, :m], state.scale[row, :m] = channel.offset, channel.scale
        for layer, (W, b) in enumerate(zip(channel.weights, channel.biases, strict=True)):
            state.weights[layer][row, : W.shape[1]] = W.T
            state.biases[layer][row, 0] = b
        state.last_layer[row], state.last_bias[row, 0] = channel.last_layer[:-1], channel.last_layer[-1]
    return state


def phi(features: ChannelFeatures, signals: NDArray[np.floating]) -> Array:
    """Phi [n, k] of signals [n, SIGNAL_COUNT], in numpy and float64. The gate compares torch's features with it."""
    h = (
        signals[:, input_indices(features.inputs, features.signals)].astype(np.float64) - features.offset
    ) / features.scale
    for W, b in zip(features.weights, features.biases, strict=True):
        h = np.tanh(h @ W.T + b)
    return np.hstack([h, np.ones((h.shape[0], 1))])
