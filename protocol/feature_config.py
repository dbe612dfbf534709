"""The `features` section of a flight: inputs, scales and widths of the feature networks, for onboard and offboard."""

from collections.abc import Mapping
from dataclasses import fields
from hashlib import blake2b
from operator import itemgetter
from typing import Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from configs.loader import ConfigRecord, RecordT, fill_section
from protocol.conventions import Array
from protocol.feature_set import AXES, LAYERS_MAX, WIDTH_MAX
from protocol.messages import LAYOUT_BYTES, SampleBatch
from protocol.signals import CHANNELS, SIGNAL_NAMES, SIGNALS, input_indices

ChannelName = Literal["position", "attitude"]


class SignalScale(ConfigRecord):
    """How a signal becomes an input of about unit size: z = (signal - offset) / scale."""

    offset: float = Field(description="in the signal's unit")
    scale: float = Field(gt=0.0, description="in the signal's unit")


class FeatureInputs(ConfigRecord):
    """What the features of both channels see, and their widths."""

    signals: ClassVar[tuple[str, ...]] = SIGNAL_NAMES
    all_channels: ClassVar[tuple[str, ...]] = CHANNELS
    outputs: ClassVar[int] = AXES

    position_inputs: tuple[str, ...] = Field(min_length=1, description="signals the position features see")
    attitude_inputs: tuple[str, ...] = Field(min_length=1, description="signals the attitude features see")
    hidden: tuple[int, ...] = Field(min_length=1, max_length=LAYERS_MAX - 1, description="widths of the hidden layers")
    count: int = Field(ge=2, le=WIDTH_MAX + 1, description="k, features of a channel, the constant included")
    scales: dict[str, SignalScale] = Field(description="of each signal")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        for names in (self.position_inputs, self.attitude_inputs):
            input_indices(names)
        missing = [name for name in self._scaled() if name not in self.scales]
        unknown = [name for name in self.scales if name not in SIGNAL_NAMES]
        if missing or unknown:
            raise ValueError(f"scales: missing {missing}, unknown {unknown}")
        if not all(1 <= width <= WIDTH_MAX for width in self.hidden):
            raise ValueError(f"hidden: widths from 1 to {WIDTH_MAX}")
        return self

    def _scaled(self) -> tuple[str, ...]:
        """The signals that need a scale."""
        return self.position_inputs + self.attitude_inputs

    def inputs(self, channel: str) -> tuple[str, ...]:
        """Input names of a channel."""
        return self.position_inputs if channel == "position" else self.attitude_inputs

    def offset_and_scale(self, names: tuple[str, ...]) -> tuple[Array, Array]:
        """Offset and scale [m] of the named signals, in their units."""
        scales = [self.scales[name] for name in names]
        return np.array([one.offset for one in scales]), np.array([one.scale for one in scales])


class TrainedFeatures(FeatureInputs):
    """The networks that offboard trains (docs/control.md, "Features")."""

    channels: tuple[ChannelName, ...] = Field(
        default=("position", "attitude"), min_length=1, description="channels that get learnt features"
    )
    spectral_norm_max: float = Field(
        default=2.5, gt=0.0, description="bound on each inner layer's largest singular value"
    )
    first_layer_gain: float = Field(default=1.0, gt=0.0, description="spread of the random first layer")
    dropout: float = Field(default=0.0, ge=0.0, lt=1.0, description="share of the features dropped in a training step")
    scaling: Literal["fixed", "data"] = Field(
        default="fixed",
        description="fixed: the scales; data: mean and spread of the first training set, at least half the scales",
    )

    @model_validator(mode="after")
    def _no_channel_twice(self) -> Self:
        if len(set(self.channels)) != len(self.channels):
            raise ValueError("channels: a channel is named twice")
        return self

    def _scaled(self) -> tuple[str, ...]:
        """All signals: the novelty of a sample may be judged by any of them."""
        return SIGNAL_NAMES


class UntrainedFeatures(FeatureInputs):
    """What a flight starts with, until the first version comes."""

    start: Literal["constant", "random"] = Field(
        default="random",  # as in recorded flights of before there was the other
        description="network features before the first version: the constant 1 alone, or random layers",
    )


class FeaturesConfig(ConfigRecord):
    """The whole section. Both sides hold their own copy."""

    trained: TrainedFeatures
    untrained: UntrainedFeatures = Field(
        description="onboard's start features and radial basis functions; of the latter, inputs and scales only"
    )


def with_features(tree: Mapping[str, Any], source: str) -> dict[str, Any]:
    """A flight's plain tree whose `onboard` and `offboard` sections hold a checked copy of its `features` section.

    Raises
    ------
    ConfigError
        If the section does not fit; names `source`, path, value and what is allowed.
    """
    features = fill_section(FeaturesConfig, tree, source, "features")
    sections = {name: tree[name] for name in ("onboard", "offboard") if isinstance(tree.get(name), Mapping)}
    return {**tree, **{name: {**section, "features": features} for name, section in sections.items()}}


def fill_process(record_type: type[RecordT], tree: Mapping[str, Any], source: str, name: str) -> RecordT:
    """The record of one process, from its section and its copy of `features`. Raises ConfigError."""
    return fill_section(record_type, with_features(tree, source), source, name)


def feature_digest(features: FeaturesConfig) -> bytes:
    """8 bytes that are the same on two sides with the same inputs, widths and scales and the same layout of a sample.

    What only the training reads (spectral bound, dropout and the like) does not count.
    """
    shared = [
        (one.position_inputs, one.attitude_inputs, one.hidden, one.count, sorted(one.scales.items(), key=itemgetter(0)))
        for one in (features.trained, features.untrained)
    ]
    sample = [field.name for field in fields(SampleBatch)]
    return blake2b(repr((shared, sample, SIGNALS, CHANNELS)).encode(), digest_size=LAYOUT_BYTES).digest()
