"""Decides whether to send a trained feature version. `Verdict` lists the reasons for refusing one."""

from dataclasses import dataclass
from enum import IntEnum
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from offboard.config import GateConfig
from protocol.conventions import Array
from protocol.feature_config import TrainedFeatures
from protocol.feature_set import FeatureSet
from protocol.signals import CHANNELS

NUMPY_TOLERANCE: Final = 1e-4
"""Largest difference between torch's features (float32) and numpy's (float64) that rounding explains."""
NEIGHBOUR_BLOCK_NS: Final = 200_000_000
"""Errors less than a smoothing window apart are not independent: the standard error is computed over such blocks."""


class Verdict(IntEnum):
    """The decision on a candidate: send it, or the first reason for refusing it."""

    SEND = 0
    TOO_FEW_SAMPLES = 1
    NOT_FINITE = 2
    SPECTRAL_NORM = 3
    NUMPY_DIFFERS = 4
    TOO_SOON = 5
    NOT_TRIGGERED = 6
    """It would hardly explain more than the flying version does."""
    NOT_SIGNIFICANT = 7
    """It seems to explain more, but by less than a standard error."""
    CHANNEL_WORSE = 8
    """It explains more in one channel, but significantly less in the other."""


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What a round measured of its candidate on held-out samples."""

    time_ns: NDArray[np.int64]
    """[n], of the samples."""
    candidate_errors: Array
    """[n, 2]: squared error of each channel, (m/s^2)^2 and (rad/s^2)^2; NaN where the sample has no label of it."""
    flying_errors: Array
    """[n, 2]: the same of the flying version."""
    label_power: Array
    """[2]: mean squared norm of the labels; NaN for a channel that is not learnt, or has no label."""
    numpy_difference: float
    """Largest difference of a feature between torch and numpy."""
    spectral_norms: tuple[float, ...]
    """norm(W_i)_2 of every inner layer."""


class _Gain(NamedTuple):
    """What the held-out samples say about one channel of a candidate (Gate._compare)."""

    triggers: bool
    significant: bool
    worse: bool


class Gate:
    """Judges candidates; it stores when the last version was sent.

    Parameters
    ----------
    networks: for the channels that are learnt, and the bound on the spectral norms.
    """

    def __init__(self, config: GateConfig, networks: TrainedFeatures) -> None:
        self._config = config
        self._spectral_norm_max = networks.spectral_norm_max
        self._learnt = [channel for channel, name in enumerate(CHANNELS) if name in networks.channels]
        self._last_sent_ns: int | None = None

    def judge(self, candidate: FeatureSet, evidence: Evidence, now_ns: int) -> Verdict:
        """The first reason for refusing the candidate, or SEND."""
        known = np.isfinite(evidence.flying_errors)
        if known[:, self._learnt].sum(axis=0).min() < self._config.minimum_validation:
            return Verdict.TOO_FEW_SAMPLES
        if not (np.isfinite(evidence.candidate_errors[known]).all() and _is_finite(candidate)):
            return Verdict.NOT_FINITE
        if max(evidence.spectral_norms) > self._spectral_norm_max:
            return Verdict.SPECTRAL_NORM
        if not evidence.numpy_difference <= NUMPY_TOLERANCE:
            return Verdict.NUMPY_DIFFERS
        if self._last_sent_ns is not None and now_ns - self._last_sent_ns < self._config.interval_s * 1e9:
            return Verdict.TOO_SOON
        return self._compare(evidence)

    def _compare(self, evidence: Evidence) -> Verdict:
        """SEND if the candidate promises to explain clearly more of a channel, and explains no channel worse.

        With e_fly, e_new the squared errors on held-out samples, g = mean(e_fly - e_new) and se its standard error:

        - The event. mean(e_new) is what training leaves: the noise of the labels, and what the inputs cannot explain.
          The error that the vehicle feels cannot fall below it, so only a gain of its size counts:
          g > trigger mean(e_new). The noise of the labels is in both errors and cancels in g.
        - The evidence: g > significance se.
        - No harm: a channel is worse if g < -margin mean(e_fly) - significance se.
        """
        gains = [self._gain(evidence, channel) for channel in self._learnt]
        if not any(gain.triggers for gain in gains):
            return Verdict.NOT_TRIGGERED
        if any(gain.worse for gain in gains):
            return Verdict.CHANNEL_WORSE
        sure = any(gain.triggers and gain.significant for gain in gains)
        return Verdict.SEND if sure else Verdict.NOT_SIGNIFICANT

    def _gain(self, evidence: Evidence, channel: int) -> "_Gain":
        config, known = self._config, np.isfinite(evidence.flying_errors[:, channel])
        e_fly, e_new = evidence.flying_errors[known, channel], evidence.candidate_errors[known, channel]
        gain, se = mean_and_error(e_fly - e_new, evidence.time_ns[known])
        return _Gain(
            triggers=gain > config.trigger * float(e_new.mean()),
            significant=gain > config.significance * se,
            worse=gain < -config.margin * float(e_fly.mean()) - config.significance * se,
        )

    def note_sent(self, now_ns: int) -> None:
        """Store that a version was sent at `now_ns`."""
        self._last_sent_ns = now_ns


def mean_and_error(values: Array, time_ns: NDArray[np.int64]) -> tuple[float, float]:
    """Mean of the values [n] and its standard error, in which each block of NEIGHBOUR_BLOCK_NS counts as one value."""
    _, block = np.unique(time_ns // NEIGHBOUR_BLOCK_NS, return_inverse=True)
    sums, counts = np.bincount(block, weights=values), np.bincount(block)
    mean = float(values.mean())
    if counts.size < 2:
        return mean, float("inf")
    deviations = sums - mean * counts
    return mean, float(np.sqrt(np.sum(deviations**2) * counts.size / (counts.size - 1)) / values.shape[0])


def _is_finite(candidate: FeatureSet) -> bool:
    return all(bool(np.isfinite(array).all()) for channel in candidate.channels for array in channel.parameters)
