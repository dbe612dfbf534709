"""Brings feature versions, and the features that a flight starts with, into the structures of the C core."""

from typing import Any

import numpy as np

from onboard.config import OnboardConfig
from onboard.control.features import NetworkFeatures
from onboard.control.laws.adaptive import AdaptiveAugmentation
from protocol.conventions import Array
from protocol.feature_set import ChannelFeatures, FeatureSet
from protocol.messages import FeatureChunk
from protocol.signals import CHANNELS, input_indices


def view(member: Any) -> Any:
    """A member of a structure that is an array, as a numpy array on the same memory."""
    return np.ctypeslib.as_array(member)


def put_selection(target: Any, inputs: tuple[str, ...], offset: Array, scale: Array) -> None:
    """Fill a FeatureSelection: names of the m inputs, offset and scale [m] in their units."""
    target.count = len(inputs)
    view(target.index)[: len(inputs)] = input_indices(inputs)
    view(target.offset)[: len(inputs)], view(target.scale)[: len(inputs)] = offset, scale


def put_channel(target: Any, source: ChannelFeatures) -> None:
    """Fill a ChannelFeatures."""
    put_selection(target.selection, source.inputs, source.offset, source.scale)
    target.network.layers = len(source.weights)
    view(target.network.width)[: len(source.weights)] = [W.shape[0] for W in source.weights]
    layers = [np.hstack([W, b[:, None]]).reshape(-1) for W, b in zip(source.weights, source.biases, strict=True)]
    parameters = np.concatenate(layers)
    view(target.network.parameters)[: len(parameters)] = parameters
    view(target.last_layer)[: source.last_layer.size] = source.last_layer.reshape(-1)


def put_feature_set(target: Any, source: FeatureSet) -> None:
    """Fill a FeatureSet."""
    target.version, target.parent, target.samples = source.version, source.parent, source.samples
    for index, channel in enumerate(source.by_channel):
        target.covers[index] = channel is not None
        if channel is not None:
            put_channel(target.channels[index], channel)


def put_chunk(target: Any, source: FeatureChunk) -> None:
    """Fill a FeatureChunk."""
    target.version, target.index, target.count = source.version, source.index, source.count
    view(target.digest)[:] = np.frombuffer(source.digest, np.uint8)
    target.size = len(source.data)
    view(target.data)[: target.size] = np.frombuffer(source.data, np.uint8)


def put_start_features(targets: Any, config: OnboardConfig) -> None:
    """Fill two ChannelFeatures with what the laws of a cascade start with; nothing for a law without features."""
    controller: Any = config.controller.build(config.airframe, config.features, config.seed)
    untrained = config.features.untrained
    for target, name, law in zip(targets, CHANNELS, controller.augmentations, strict=True):
        if not isinstance(law, AdaptiveAugmentation):
            continue
        if isinstance(law.features, NetworkFeatures):
            put_channel(target, law.features.channel)
        else:  # radial functions; the bias alone uses nothing
            inputs = untrained.inputs(name)
            put_selection(target.selection, inputs, *untrained.offset_and_scale(inputs))
