"""Statistics of campaigns: how sure a number is. Survivors and crashes are always told apart.

Every resampling takes its generator as an argument, so that a report is the same whenever it is made.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import binomtest

from protocol.conventions import Array

CONFIDENCE: Final = 0.95
Z_95: Final = 1.959963984540054
"""Normal quantile at 0.975."""
RESAMPLES: Final = 4000
INTERVAL_COUNT: Final = 6
"""Of fewer values no interval of the median is stated: even from the least to the greatest of five covers only 94 %.

The percentile bootstrap's interval is narrower than it should be where values are few: with six to ten it covers the
true median of normal samples in 86 to 94 % of cases, with twenty to a hundred in 94 % (2000 simulated samples each).
"""


@dataclass(frozen=True)
class Estimate:
    """A number with its 95 % interval; NaN where there is none."""

    value: float
    low: float
    high: float
    count: int
    """What it rests on: flights, or pairs."""


def wilson(successes: int, trials: int, z: float = Z_95) -> Estimate:
    """Share of successes with the Wilson score interval (Wilson 1927).

    Raises
    ------
    ValueError
        If the counts are not 0 <= successes <= trials.
    """
    if not 0 <= successes <= trials:
        raise ValueError(f"{successes} successes in {trials} trials")
    if trials == 0:
        return Estimate(math.nan, 0.0, 1.0, 0)
    share, z2 = successes / trials, z * z
    denominator = 1.0 + z2 / trials
    centre = (share + z2 / (2 * trials)) / denominator
    half = z * math.sqrt(share * (1.0 - share) / trials + z2 / (4.0 * trials * trials)) / denominator
    low = 0.0 if successes == 0 else centre - half
    high = 1.0 if successes == trials else centre + half
    return Estimate(share, low, high, trials)


def median(values: Sequence[float], rng: np.random.Generator, resamples: int = RESAMPLES) -> Estimate:
    """Median of the finite values with its percentile bootstrap interval."""
    known = _finite(values)
    return _bootstrap(known, lambda rows: np.median(rows, axis=1), rng, resamples)


def paired_ratio(
    ours: Mapping[int, float], theirs: Mapping[int, float], rng: np.random.Generator, resamples: int = RESAMPLES
) -> Estimate:
    """Median over seeds of ours / theirs, seeds that both have, with its bootstrap interval over seeds.

    Flights that were lost are not in the mappings, or are NaN; the caller states how many there were.
    """
    seeds = sorted(set(ours) & set(theirs))
    ratios = [ours[seed] / theirs[seed] for seed in seeds if theirs[seed] > 0.0]
    return median(ratios, rng, resamples)


def outcomes_differ(ours: Mapping[int, bool], theirs: Mapping[int, bool]) -> bool:
    """Whether two shares of survivors differ at the 95 % level, paired by seed: McNemar's test in its exact form.

    Of the seeds on which the outcomes differ, half should go either way if the shares are equal (McNemar 1947; the
    binomial tail instead of chi squared). Fewer than six such seeds never suffice.
    """
    only_ours, only_theirs = _discordant(ours, theirs)
    discordant = only_ours + only_theirs
    return discordant > 0 and float(binomtest(only_ours, discordant).pvalue) < 1.0 - CONFIDENCE


def survives_less(ours: Mapping[int, bool], theirs: Mapping[int, bool]) -> bool:
    """Whether the outcomes differ in that sense, to our disadvantage; seeds that only one flew say nothing."""
    only_ours, only_theirs = _discordant(ours, theirs)
    return only_ours < only_theirs and outcomes_differ(ours, theirs)


def _discordant(ours: Mapping[int, bool], theirs: Mapping[int, bool]) -> tuple[int, int]:
    """On how many seeds only ours survived, and on how many only theirs."""
    seeds = set(ours) & set(theirs)
    only_ours = sum(ours[seed] and not theirs[seed] for seed in seeds)
    return only_ours, sum(theirs[seed] and not ours[seed] for seed in seeds)


def _finite(values: Sequence[float]) -> Array:
    array: Array = np.asarray(values, dtype=np.float64)
    return array[np.isfinite(array)]


def _bootstrap(
    values: Array, statistic: Callable[[Array], Array], rng: np.random.Generator, resamples: int
) -> Estimate:
    count = values.size
    if count == 0:
        return Estimate(math.nan, math.nan, math.nan, 0)
    value = float(statistic(values[None, :])[0])
    if count < INTERVAL_COUNT:
        return Estimate(value, math.nan, math.nan, count)
    drawn = statistic(values[rng.integers(0, count, (resamples, count))])
    low, high = np.quantile(drawn, ((1.0 - CONFIDENCE) / 2.0, (1.0 + CONFIDENCE) / 2.0))
    return Estimate(value, float(low), float(high), count)


@dataclass(frozen=True)
class LogisticFit:
    """survival probability = 1 / (1 + exp(-(intercept + slope x)))."""

    intercept: float
    slope: float

    @property
    def half_point(self) -> float:
        """Where half survive; NaN for a flat curve."""
        return -self.intercept / self.slope if self.slope != 0.0 else math.nan

    def probability(self, x: ArrayLike) -> Array:
        """At x [n]."""
        return _sigmoid(self.intercept + self.slope * np.asarray(x, dtype=np.float64))


def logistic_fit(x: ArrayLike, survived: ArrayLike, ridge: float = 0.0) -> LogisticFit:
    """Maximum likelihood by Newton's method (iteratively reweighted least squares), x standardised inside.

    Parameters
    ----------
    ridge: penalty on the standardised slope, 0.5 ridge slope^2, which keeps the fit finite where a threshold
        separates the outcomes perfectly.

    Raises
    ------
    ValueError
        If x has fewer than two values, or all outcomes are the same.
    """
    position: Array = np.asarray(x, dtype=np.float64)
    outcome: Array = np.asarray(survived, dtype=np.float64)
    if np.ptp(position) == 0.0 or np.ptp(outcome) == 0.0:
        raise ValueError("a logistic fit needs two places and both outcomes")
    mean, spread = float(position.mean()), float(position.std())
    design = np.stack([np.ones_like(position), (position - mean) / spread], axis=1)
    penalty = np.diag([0.0, ridge])
    beta: Array = np.zeros(2)
    for _ in range(100):
        p = _sigmoid(design @ beta)
        weight = np.maximum(p * (1.0 - p), 1e-12)
        gradient = design.T @ (outcome - p) - penalty @ beta
        hessian = (design * weight[:, None]).T @ design + penalty
        step = np.linalg.solve(hessian, gradient)
        step *= min(1.0, 5.0 / max(float(np.abs(step).max()), 1e-12))
        beta = beta + step
        if float(np.abs(step).max()) < 1e-9:
            break
    slope = float(beta[1]) / spread
    return LogisticFit(float(beta[0]) - slope * mean, slope)


SEPARATION_RIDGE: Final = 0.05
"""Of the survival fits: small against the information of ten flights, enough for a perfect threshold."""


def half_survival_point(
    x: ArrayLike, survived: ArrayLike, seeds: ArrayLike, rng: np.random.Generator, resamples: int = 1000
) -> Estimate:
    """Where half survive, by logistic fit, with its bootstrap interval over seeds; NaN if one outcome is missing.

    A seed's vehicle flies at every x, so its outcomes are not independent: it is drawn with all its flights or not
    at all. A resample in which only one outcome occurs counts as a point beyond the range on that side.

    Parameters
    ----------
    x, survived, seeds: [n], a flight each.
    """
    position: Array = np.asarray(x, dtype=np.float64)
    outcome = np.asarray(survived, dtype=bool)
    if position.size == 0 or outcome.all() or not outcome.any() or np.ptp(position) == 0.0:
        return Estimate(math.nan, math.nan, math.nan, position.size)
    fit = logistic_fit(position, outcome, SEPARATION_RIDGE)
    points: Array = np.empty(resamples)
    seed = np.asarray(seeds)
    flights_of = [np.flatnonzero(seed == one) for one in np.unique(seed)]
    for number in range(resamples):
        rows = np.concatenate([flights_of[one] for one in rng.integers(0, len(flights_of), len(flights_of))])
        points[number] = _half_point(position[rows], outcome[rows], fit.slope > 0.0)
    low, high = np.quantile(points, ((1.0 - CONFIDENCE) / 2.0, (1.0 + CONFIDENCE) / 2.0), method="nearest")
    return Estimate(fit.half_point, float(low), float(high), position.size)


def _half_point(x: Array, survived: NDArray[np.bool_], rising: bool) -> float:
    if survived.all():
        return -math.inf if rising else math.inf
    if not survived.any():
        return math.inf if rising else -math.inf
    if np.ptp(x) == 0.0:
        return float(x[0])
    return logistic_fit(x, survived, SEPARATION_RIDGE).half_point


def _sigmoid(z: Array) -> Array:
    clipped = np.clip(z, -500.0, 500.0)
    positive: Array = 1.0 / (1.0 + np.exp(-clipped))
    return positive
