"""Is a trained version worth sending? Every reason not to is a member of Verdict."""

from dataclasses import dataclass
from enum import IntEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from offboard.config import GateConfig
from protocol.conventions import Array
from protocol.feature_set import FeatureSet

NUMPY_TOLERANCE: Final = 1e-4
"""Largest difference of a feature between torch's float32 and numpy's float64 forward pass that is rounding."""
NEIGHBOUR_BLOCK_NS: Final = 200_000_000
"""Errors closer than a smoothing window are not independent: significance is counted over blocks of this length."""


class Verdict(IntEnum):
    """What becomes of a candidate."""

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
    """What a round found out about its candidate, on held-out samples."""

    time_ns: NDArray[np.int64]
    """[n]"""
    candidate_errors: Array
    """[n, 2]: squared error of each channel, (m/s^2)^2 and (rad/s^2)^2."""
    flying_errors: Array
    """[n, 2]: the same of the version in the air."""
    label_power: Array
    """[2]: mean squared norm of the labels; NaN for a channel that is not learnt."""
    numpy_difference: float
    """Largest difference of a feature between torch and numpy."""
    spectral_norms: tuple[float, ...]
    """Of every inner layer."""


class Gate:
    """Decides, and remembers when it last let one through."""

    def __init__(self, config: GateConfig, spectral_norm_max: float) -> None:
        self._config = config
        self._spectral_norm_max = spectral_norm_max
        self._last_sent_ns: int | None = None

    def judge(self, candidate: FeatureSet, evidence: Evidence, now_ns: int) -> Verdict:
        """The first reason against sending, or SEND."""
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
        """Triggered and significantly better in one channel, significantly worse in none."""
        verdict = Verdict.NOT_TRIGGERED
        learnt = np.flatnonzero(np.isfinite(evidence.label_power))
        for channel in learnt:
            flying, new = evidence.flying_errors[:, channel], evidence.candidate_errors[:, channel]
            gain, doubt = mean_and_error(flying - new, evidence.time_ns)
            if gain < -self._config.margin * flying.mean() - self._config.significance * doubt:
                return Verdict.WORSE_ELSEWHERE
            if flying.mean() <= self._config.trigger_unexplained * evidence.label_power[channel]:
                continue
            better = gain > max(self._config.margin * float(flying.mean()), self._config.significance * doubt)
            if better:
                verdict = Verdict.SEND
            elif verdict is not Verdict.SEND:
                verdict = Verdict.NOT_BETTER
        return verdict

    def note_sent(self, now_ns: int) -> None:
        """A version was let through at `now_ns`."""
        self._last_sent_ns = now_ns


def mean_and_error(values: Array, time_ns: NDArray[np.int64]) -> tuple[float, float]:
    """Mean of the values [n] and its standard error, neighbours in time counted as one."""
    _, block = np.unique(time_ns // NEIGHBOUR_BLOCK_NS, return_inverse=True)
    sums, counts = np.bincount(block, weights=values), np.bincount(block)
    mean = float(values.mean())
    if counts.size < 2:
        return mean, float("inf")
    deviations = sums - mean * counts
    return mean, float(np.sqrt(np.sum(deviations**2) * counts.size / (counts.size - 1)) / values.shape[0])


def _is_finite(candidate: FeatureSet) -> bool:
    channels = [channel for channel in (candidate.position, candidate.attitude) if channel is not None]
    arrays = [array for channel in channels for array in (*channel.weights, *channel.biases, channel.last_layer)]
    return all(bool(np.isfinite(array).all()) for array in arrays)
