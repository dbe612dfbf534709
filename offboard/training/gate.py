"""Decides whether to send a trained feature version. `Verdict` lists the reasons for refusing one."""

from dataclasses import dataclass
from enum import IntEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from offboard.config import GateConfig
from protocol.conventions import Array
from protocol.feature_set import FeatureSet

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
    NOT_BETTER = 7
    WORSE_ELSEWHERE = 8


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What a round measured of its candidate on held-out samples."""

    time_ns: NDArray[np.int64]
    """[n], of the samples."""
    candidate_errors: Array
    """[n, 2]: squared error of each channel, (m/s^2)^2 and (rad/s^2)^2."""
    flying_errors: Array
    """[n, 2]: the same of the flying version."""
    label_power: Array
    """[2]: mean squared norm of the labels; NaN for a channel that is not learnt."""
    numpy_difference: float
    """Largest difference of a feature between torch and numpy."""
    spectral_norms: tuple[float, ...]
    """norm(W_i)_2 of every inner layer."""


class Gate:
    """Judges candidates; it stores when the last version was sent."""

    def __init__(self, config: GateConfig, spectral_norm_max: float) -> None:
        self._config = config
        self._spectral_norm_max = spectral_norm_max
        self._last_sent_ns: int | None = None

    def judge(self, candidate: FeatureSet, evidence: Evidence, now_ns: int) -> Verdict:
        """The first reason for refusing the candidate, or SEND."""
        config = self._config
        if evidence.time_ns.shape[0] < config.minimum_validation:
            return Verdict.TOO_FEW_SAMPLES
        if not (np.isfinite(evidence.candidate_errors).all() and _is_finite(candidate)):
            return Verdict.NOT_FINITE
        if max(evidence.spectral_norms) > self._spectral_norm_max:
            return Verdict.SPECTRAL_NORM
        if not evidence.numpy_difference <= NUMPY_TOLERANCE:
            return Verdict.NUMPY_DIFFERS
        if self._last_sent_ns is not None and now_ns - self._last_sent_ns < config.interval_s * 1e9:
            return Verdict.TOO_SOON
        return self._compare(evidence)

    def _compare(self, evidence: Evidence) -> Verdict:
        """SEND if the flying version explains a channel badly, and the candidate is better there and worse nowhere.

        With e_fly, e_new the squared errors and se the standard error of mean(e_fly - e_new), the candidate is
        better if mean(e_fly - e_new) > max(margin mean(e_fly), significance se), and
        worse if mean(e_fly - e_new) < -margin mean(e_fly) - significance se.
        """
        verdict = Verdict.NOT_TRIGGERED
        margin, significance = self._config.margin, self._config.significance
        for channel in np.flatnonzero(np.isfinite(evidence.label_power)):
            e_fly, e_new = evidence.flying_errors[:, channel], evidence.candidate_errors[:, channel]
            gain, se = mean_and_error(e_fly - e_new, evidence.time_ns)
            if gain < -margin * e_fly.mean() - significance * se:
                return Verdict.WORSE_ELSEWHERE
            if e_fly.mean() <= self._config.trigger_unexplained * evidence.label_power[channel]:
                continue
            if gain > max(margin * float(e_fly.mean()), significance * se):
                verdict = Verdict.SEND
            elif verdict is not Verdict.SEND:
                verdict = Verdict.NOT_BETTER
        return verdict

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
