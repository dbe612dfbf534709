"""Feature channels of both cores, for tests of features, swap and laws."""

from typing import Any

import numpy as np

from onboard.c.feature_arrays import put_channel, view
from onboard.control.features import random_channel
from protocol.feature_set import ChannelFeatures
from protocol.signals import SIGNAL_COUNT

INPUTS = ("position_n", "velocity_e", "motor_thrust_3", "battery_voltage", "rate_r")


def channel(seed: int, widths: tuple[int, ...] = (32, 32, 19), gain: float = 1.0) -> ChannelFeatures:
    """A channel with random numbers everywhere."""
    rng = np.random.default_rng(seed)
    offset, scale = rng.normal(size=len(INPUTS)), rng.uniform(0.1, 2.0, len(INPUTS))
    start = random_channel(INPUTS, offset, scale, widths, rng)
    weights = tuple(gain * W for W in start.weights)
    return ChannelFeatures(INPUTS, offset, scale, weights, start.biases, rng.normal(size=start.last_layer.shape))


def signals(seed: int, count: int, size: float = 2.0) -> Any:
    """[count, SIGNAL_COUNT]."""
    return np.random.default_rng(seed).normal(scale=size, size=(count, SIGNAL_COUNT))


def c_channel(core: Any, source: ChannelFeatures) -> Any:
    """The same channel as C's ChannelFeatures."""
    target = core.ChannelFeatures()
    put_channel(target, source)
    return target


def c_network_features(core: Any, source: ChannelFeatures) -> Any:
    """C's Features of a channel."""
    given, features = c_channel(core, source), core.Features()
    core.features_init_network(features, given.selection, given.network)
    view(features.last_layer)[:] = given.last_layer
    return features
