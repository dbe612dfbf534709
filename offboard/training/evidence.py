"""What the gate judges a round by: the errors of its candidate and of the flying version on held-out samples."""

from typing import TYPE_CHECKING

import numpy as np

from offboard.data.buffer import VALIDATION, SampleTable
from offboard.training.gate import Evidence
from offboard.training.network import Array32, InputPlan, largest_singular_values, phi
from protocol.conventions import Array
from protocol.feature_codec import decode_feature_set, encode_for_wire
from protocol.feature_set import FeatureSet
from protocol.signals import CHANNELS

if TYPE_CHECKING:
    from offboard.training.job import RoundJob, TrainingJob


def evidence_of(job: "TrainingJob", candidate: FeatureSet, numpy_difference: float) -> Evidence:
    """The evidence for a candidate whose parameters are rounded as for sending."""
    table = held_out(job, VALIDATION)
    labels = table.labels.astype(np.float64)
    return Evidence(
        time_ns=table.time_ns,
        candidate_errors=squared_errors(candidate, table.signals, labels),
        flying_errors=squared_errors(job.flying, table.signals, labels),
        label_power=_power(labels, InputPlan.of(job.network_config).channels),
        numpy_difference=numpy_difference,
        spectral_norms=tuple(
            float(largest_singular_values(W[None])[0]) for channel in candidate.channels for W in channel.weights
        ),
    )


def as_sent(job: "TrainingJob", features: FeatureSet) -> FeatureSet:
    """The features with their parameters rounded as for sending."""
    return decode_feature_set(encode_for_wire(features, job.wire_dtype))


def held_out(job: "RoundJob", split: int) -> SampleTable:
    """Samples of a split, each once; a newest sample may also be in the buffer."""
    table = job.buffer.take(job.buffer.split == split).joined(job.newest.take(job.newest.split == split))
    _, first = np.unique(table.time_ns, return_index=True)
    return table.take(first)


def squared_errors(features: FeatureSet | None, signals: Array32, labels: Array) -> Array:
    """norm(y - theta' Phi)^2 of each sample and channel, [n, 2]; a channel without features predicts 0.

    NaN where the channel has no label.
    """
    errors = labels.copy()
    for at, channel in enumerate(features.by_channel if features is not None else ()):
        if channel is not None and signals.shape[0]:
            errors[:, at] -= phi(channel, signals) @ channel.last_layer
    squared: Array = np.square(errors).sum(axis=2)
    return squared


def _power(labels: Array, channels: tuple[int, ...]) -> Array:
    """Mean squared norm of the labels of each channel, [2]; NaN for a channel that is not learnt, or has no label."""
    power = np.full(len(CHANNELS), np.nan)
    for channel in channels:
        known = labels[~np.isnan(labels[:, channel, 0]), channel]
        power[channel] = np.square(known).sum(axis=1).mean() if known.shape[0] else np.nan
    return power
