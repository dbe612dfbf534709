"""Whether the maps of this flight foretell what comes: asked before the first version flies.

Held-out samples lie between samples that were trained on, so a map that only interpolates does well on them. Early in a
flight the vehicle comes to places where it has not been, and there such a map is worse than none. So each round's
candidate is tried on the samples that come after it (prequential, Dawid 1984), against what flies without a map: the
bias of the law on board, which follows the residual. With m = Delta - theta'Phi, both are judged by what that bias
leaves,

    m(t) - d(t - lag),    d_dot = rate (m - d),

of Delta itself without a map. A constant error of a map therefore costs nothing.
"""

from collections import deque
from typing import Final, NamedTuple

import numpy as np

from offboard.config import GateConfig
from offboard.data.buffer import SampleTable
from offboard.training.network import phi
from protocol.conventions import Array
from protocol.feature_set import ChannelFeatures, FeatureSet

RATE: Final = (8.0, 6.4)
"""1/s, of position and attitude: how fast a bias on board follows, about."""
LAG_S: Final = (0.14, 0.06)
"""s, from nu_cmd to its effect, about (onboard.control.watch)."""
SETTLING_NS: Final = 1_000_000_000
"""Samples before those that are judged, from which the bias settles."""


class _Part(NamedTuple):
    """The samples between two rounds."""

    seconds: float
    of_map: tuple[float, float]
    """Mean square that is left of each channel, with the map."""
    of_none: tuple[float, float]
    """The same without."""


class Forecast:
    """How the candidates so far have foretold the samples that came after them."""

    def __init__(self, config: GateConfig) -> None:
        self._config = config
        self._entrant: FeatureSet | None = None
        self._made_ns = 0
        self._parts: deque[_Part] = deque()
        self.passed = config.first_samples == 0
        """Whether a first version may fly; it stays so."""

    def enter(self, candidate: FeatureSet, made_ns: int, newest: SampleTable, samples: int) -> None:
        """Judge the candidate of the round before, and take this one in its place.

        Parameters
        ----------
        made_ns: time of the newest sample that the round of this candidate knew.
        newest: samples with labels, the oldest first, at least those since the round before.
        samples: labelled so far.
        """
        if self.passed:
            return
        if self._entrant is not None:
            self._judge(self._entrant, newest.take(newest.time_ns <= made_ns))
        self._entrant, self._made_ns = candidate, made_ns
        self.passed = samples >= self._config.first_samples or self._foretells()
        if self.passed:
            self._entrant = None
            self._parts.clear()

    def _judge(self, entrant: FeatureSet, samples: SampleTable) -> None:
        samples = samples.take(samples.time_ns > self._made_ns - SETTLING_NS)
        new = samples.time_ns > self._made_ns
        if not new.any():
            return
        of_map, of_none = [0.0, 0.0], [0.0, 0.0]
        for at, channel in enumerate(entrant.by_channel):
            known = ~np.isnan(samples.labels[:, at, 0])
            if channel is not None and (known & new).any():
                of_map[at], of_none[at] = _means(channel, at, samples.take(known), self._made_ns)
        seconds = float(samples.time_ns[-1] - self._made_ns) * 1e-9
        self._parts.append(_Part(seconds, (of_map[0], of_map[1]), (of_none[0], of_none[1])))
        while sum(part.seconds for part in self._parts) - self._parts[0].seconds >= self._config.first_evidence_s:
            self._parts.popleft()

    def _foretells(self) -> bool:
        """Whether there is enough evidence, and it is for the maps: the mean of the channels' ratios."""
        if sum(part.seconds for part in self._parts) < self._config.first_evidence_s:
            return False
        of_map, of_none = (
            np.sum([part.seconds * np.array(getattr(part, name)) for part in self._parts], axis=0)
            for name in ("of_map", "of_none")
        )
        judged = of_none > 0.0
        ratio = float((of_map[judged] / of_none[judged]).mean()) if judged.any() else np.inf
        return ratio < self._config.first_ratio**2


def _means(channel: ChannelFeatures, at: int, samples: SampleTable, after_ns: int) -> tuple[float, float]:
    """Mean squares that a bias leaves of the samples after a time: with the map, and without."""
    Delta = samples.labels[:, at].astype(np.float64)
    m = Delta - phi(channel, samples.signals) @ channel.last_layer
    time_s = samples.time_ns.astype(np.float64) * 1e-9
    left = left_by_bias(time_s, np.hstack([m, Delta]), RATE[at], LAG_S[at])
    squares = np.square(left[samples.time_ns > after_ns])
    return float(squares[:, :3].sum(axis=1).mean()), float(squares[:, 3:].sum(axis=1).mean())


def left_by_bias(time_s: Array, m: Array, rate: float, lag_s: float) -> Array:
    """m(t) - d(t - lag), d_dot = rate (m - d), of every column; d is zero before the first row.

    Parameters
    ----------
    time_s: [n], increasing. m: [n, k].
    """
    d = np.zeros_like(m)
    shares = 1.0 - np.exp(-rate * np.diff(time_s))
    for row, share in enumerate(shares.tolist(), start=1):
        d[row] = d[row - 1] + share * (m[row] - d[row - 1])
    then = np.searchsorted(time_s, time_s - lag_s + 1e-6, side="right") - 1
    left: Array = m - np.where((then >= 0)[:, None], d[then], 0.0)
    return left
