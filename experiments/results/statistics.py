"""Statistics of campaigns: estimates with intervals, and paired tests. Survivors and crashes are never mixed.

Every resampling gets its generator as an argument, so that a report is repeatable.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import expit
from scipy.stats import binomtest, bootstrap

from protocol.conventions import Array

CONFIDENCE: Final = 0.95
SIGNIFICANT: Final = 0.05
"""A verdict needs a corrected p value below this."""
RESAMPLES: Final = 4000
INTERVAL_COUNT: Final = 6
"""Fewest values for an interval of the median: the range of five values covers it in only 94 % of the cases.

With few values the percentile bootstrap gives intervals that are too narrow: with six to ten values they cover the
true median of normal samples in 86 to 94 % of the cases, with twenty to a hundred in 94 % (2000 simulations each).
"""


@dataclass(frozen=True)
class Estimate:
    """A number with its 95 % interval; NaN where there is none."""

    value: float
    low: float
    high: float
    count: int
    """Number of flights, or of pairs."""


def wilson(successes: int, trials: int) -> Estimate:
    """Return the share of successes with the Wilson score interval (Wilson 1927).

    Raises
    ------
    ValueError
        If the counts are not 0 <= successes <= trials.
    """
    if trials == 0 == successes:
        return Estimate(math.nan, 0.0, 1.0, 0)
    found = binomtest(successes, trials)
    interval = found.proportion_ci(CONFIDENCE, method="wilson")
    return Estimate(found.statistic, float(interval.low), float(interval.high), trials)


def median(values: Sequence[float], rng: np.random.Generator, resamples: int = RESAMPLES) -> Estimate:
    """Return the median of the finite values with its percentile bootstrap interval."""
    known: Array = np.asarray(values, dtype=np.float64)
    known = known[np.isfinite(known)]
    if known.size == 0:
        return Estimate(math.nan, math.nan, math.nan, 0)
    value = float(np.median(known))
    if known.size < INTERVAL_COUNT:
        return Estimate(value, math.nan, math.nan, known.size)
    drawn = bootstrap(
        (known,), np.median, n_resamples=resamples, confidence_level=CONFIDENCE, method="percentile", rng=rng
    )
    return Estimate(value, float(drawn.confidence_interval.low), float(drawn.confidence_interval.high), known.size)


def paired_ratio(
    ours: Mapping[int, float], theirs: Mapping[int, float], rng: np.random.Generator, resamples: int = RESAMPLES
) -> Estimate:
    """Return the median of ours / theirs over the seeds that both have, with its bootstrap interval over seeds.

    Vehicles that crashed are not in the mappings, or are NaN; the caller states their number.
    """
    seeds = sorted(set(ours) & set(theirs))
    ratios = [ours[seed] / theirs[seed] for seed in seeds if theirs[seed] > 0.0]
    return median(ratios, rng, resamples)


def sign_test(ours: Mapping[int, float], theirs: Mapping[int, float]) -> tuple[int, int, float]:
    """Compare two quantities on the seeds that both have by the exact sign test.

    For survival (bool) this is McNemar's test (McNemar 1947) with the binomial tail instead of chi squared.

    Returns
    -------
    Number of seeds on which ours is less and more, and the two-sided p value that both are equally likely.
    """
    seeds = set(ours) & set(theirs)
    less = sum(ours[seed] < theirs[seed] for seed in seeds)
    more = sum(ours[seed] > theirs[seed] for seed in seeds)
    return less, more, float(binomtest(less, less + more).pvalue) if less + more else 1.0


def holm(p_values: Sequence[float]) -> list[float]:
    """Correct p values for their number: the probability of one false rejection or more stays below the level.

    Step-down method of Holm (1979), "A simple sequentially rejective multiple test procedure", Scand. J. Statist. 6:
    in ascending order, p_(k) becomes the maximum over j <= k of min(1, (n - j + 1) p_(j)).
    """
    corrected, largest = [1.0] * len(p_values), 0.0
    for rank, index in enumerate(sorted(range(len(p_values)), key=p_values.__getitem__)):
        largest = max(largest, min(1.0, (len(p_values) - rank) * p_values[index]))
        corrected[index] = largest
    return corrected


@dataclass(frozen=True)
class LogisticFit:
    """survival probability = 1 / (1 + exp(-(intercept + slope x)))."""

    intercept: float
    slope: float

    @property
    def half_point(self) -> float:
        """Return x where half survive; NaN for a flat curve."""
        return -self.intercept / self.slope if self.slope != 0.0 else math.nan

    def probability(self, x: ArrayLike) -> Array:
        """Return the survival probability at x [n]."""
        likely: Array = expit(self.intercept + self.slope * np.asarray(x, dtype=np.float64))
        return likely


def logistic_fit(x: ArrayLike, survived: ArrayLike, ridge: float = 0.0) -> LogisticFit:
    """Fit by maximum likelihood, with scikit-learn's Newton method on standardised x.

    Parameters
    ----------
    ridge: penalty on the standardised slope, 0.5 ridge slope^2; keeps the fit finite if a threshold separates the
        outcomes perfectly.

    Raises
    ------
    ValueError
        If x has fewer than two values, or all outcomes are the same.
    """
    from sklearn.linear_model import LogisticRegression  # half a second

    position: Array = np.asarray(x, dtype=np.float64)
    mean, spread = float(position.mean()), float(position.std())
    if spread == 0.0:
        raise ValueError("a logistic fit needs two values of x and both outcomes")
    strength = 1.0 / ridge if ridge > 0.0 else math.inf
    fit = LogisticRegression(C=strength, solver="newton-cholesky", tol=1e-8, max_iter=1000)
    fit.fit((position[:, None] - mean) / spread, np.asarray(survived, dtype=bool))
    slope = float(fit.coef_[0, 0]) / spread
    return LogisticFit(float(fit.intercept_[0]) - slope * mean, slope)


SEPARATION_RIDGE: Final = 0.05
"""Ridge of the survival fits: small compared with the information of ten flights, enough for a perfect threshold."""


def half_survival_point(
    x: ArrayLike, survived: ArrayLike, seeds: ArrayLike, rng: np.random.Generator, resamples: int = 1000
) -> Estimate:
    """Return x where half survive, by logistic fit, with its bootstrap interval; NaN if one outcome is missing.

    A seed's vehicle flies at every x, so its outcomes are not independent: a resample contains all of its flights or
    none. If only one outcome occurs in a resample, its point is infinite, on the corresponding side.

    Parameters
    ----------
    x, survived, seeds: [n], one element for each flight.
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
