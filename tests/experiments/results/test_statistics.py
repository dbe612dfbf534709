"""Statistics against scipy, scikit-learn, and values published elsewhere."""

import math

import numpy as np
import pytest

from experiments.results.statistics import (
    LogisticFit,
    half_survival_point,
    holm,
    logistic_fit,
    median,
    paired_ratio,
    sign_test,
    wilson,
)


def test_wilson_published_values() -> None:
    """Newcombe 1998, table I: 81 of 263, 15 of 148, 0 of 20, 1 of 29."""
    for successes, trials, low, high in ((81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (1, 29, 0.0061, 0.1718)):
        estimate = wilson(successes, trials)
        assert (round(estimate.low, 4), round(estimate.high, 4)) == (low, high)
    assert wilson(0, 20).high == pytest.approx(0.1611, abs=5e-5)
    assert wilson(0, 0).count == 0


def test_wilson_refuses_impossible_counts() -> None:
    with pytest.raises(ValueError, match="must not be greater"):
        wilson(3, 2)


def test_the_interval_is_that_of_the_resampled_medians() -> None:
    """Percentile bootstrap (Efron 1979), written out."""
    values = np.random.default_rng(0).lognormal(size=60)
    drawn = np.random.default_rng(1).integers(0, 60, (4000, 60))
    ours = median(list(values), np.random.default_rng(1))
    assert ours.value == np.median(values)
    assert (ours.low, ours.high) == pytest.approx(tuple(np.quantile(np.median(values[drawn], axis=1), (0.025, 0.975))))


def test_median_interval_covers_the_truth() -> None:
    rng = np.random.default_rng(3)
    covered = 0
    for _ in range(200):
        estimate = median(list(rng.normal(size=25)), rng, 400)
        covered += estimate.low <= 0.0 <= estimate.high
    assert 0.90 <= covered / 200 <= 0.99


def test_median_ignores_values_that_are_not_finite() -> None:
    estimate = median([1.0, math.nan, 3.0, math.inf, 2.0], np.random.default_rng(0))
    assert (estimate.value, estimate.count) == (2.0, 3)
    assert math.isnan(median([], np.random.default_rng(0)).value)
    assert math.isnan(median([1.0], np.random.default_rng(0)).low)


def test_ratio_is_paired_by_seed() -> None:
    """Seeds differ a hundredfold, yet ours is half of theirs for each: pairing finds it exactly."""
    theirs = {seed: 10.0**seed for seed in range(-3, 4)}
    ours = {seed: 0.5 * value for seed, value in theirs.items()} | {99: 1.0}
    estimate = paired_ratio(ours, theirs, np.random.default_rng(0))
    assert (estimate.value, estimate.low, estimate.high, estimate.count) == pytest.approx((0.5, 0.5, 0.5, 7))


@pytest.mark.parametrize(
    ("only_ours", "only_theirs", "p_value"),
    [(0, 5, 0.0625), (0, 6, 0.03125), (6, 0, 0.03125), (4, 14, 0.030884), (5, 14, 0.063568), (0, 0, 1.0)],
)
def test_survival_is_compared_on_the_same_seeds(only_ours: int, only_theirs: int, p_value: float) -> None:
    """Sign test: 2 * 0.5^5 = 0.0625, 2 * 0.5^6 = 0.031. Seeds with equal outcomes do not count."""
    outcomes = [(True, False)] * only_ours + [(False, True)] * only_theirs + [(True, True)] * 80 + [(False, False)] * 7
    ours, theirs = ({seed: pair[side] for seed, pair in enumerate(outcomes)} for side in (0, 1))
    assert sign_test(ours, theirs) == (only_theirs, only_ours, pytest.approx(p_value, rel=1e-4))
    assert sign_test(theirs, ours) == (only_ours, only_theirs, pytest.approx(p_value, rel=1e-4))
    assert sign_test({1: True}, {2: False}) == (0, 0, 1.0)


def test_seeds_that_only_one_flew_do_not_count() -> None:
    """The share of all flights points the other way here."""
    ours = {seed: seed < 10 for seed in range(100)}
    theirs = {seed: seed < 4 for seed in range(10)}
    assert sign_test(ours, theirs) == (0, 6, 0.03125)
    assert sign_test(theirs, ours) == (6, 0, 0.03125)


def test_holm_published_example() -> None:
    """p.adjust(method = "holm") of R for these values; the order stays, equal corrected values are possible."""
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.6, 0.5]) == [1.0, 1.0]
    assert holm([]) == []


def test_holm_keeps_false_verdicts_rare() -> None:
    """With 20 true hypotheses one is rejected or more in 5 % of the cases, without correction in 64 %."""
    rng = np.random.default_rng(8)
    samples = rng.random((400, 20))
    assert np.mean([min(holm(list(p))) < 0.05 for p in samples]) == pytest.approx(0.05, abs=0.03)
    assert np.mean(samples.min(axis=1) < 0.05) > 0.55


def test_logistic_fit_equals_unpenalised_likelihood() -> None:
    from scipy.optimize import minimize

    rng = np.random.default_rng(4)
    x = rng.uniform(0.5, 0.95, 400)
    y = rng.random(400) < LogisticFit(-14.0, 20.0).probability(x)
    fit = logistic_fit(list(x), list(y))

    def loss(beta: np.ndarray) -> float:
        z = beta[0] + beta[1] * (x - 0.7)
        return float(np.logaddexp(0.0, np.where(y, -z, z)).sum())

    best = minimize(loss, np.zeros(2), method="BFGS").x
    assert fit.slope == pytest.approx(best[1], rel=1e-3)
    assert fit.half_point == pytest.approx(0.7 - best[0] / best[1], abs=1e-4)


def test_logistic_fit_published_example() -> None:
    """Hours of study and passing an exam, a standard example: intercept -4.0777, slope 1.5046, half point 2.71 h."""
    hours = [0.5, 0.75, 1, 1.25, 1.5, 1.75, 1.75, 2, 2.25, 2.5, 2.75, 3, 3.25, 3.5, 4, 4.25, 4.5, 4.75, 5, 5.5]
    passed = [0, 0, 0, 0, 0, 0, 1, 0, 1, 0, 1, 0, 1, 0, 1, 1, 1, 1, 1, 1]
    fit = logistic_fit(hours, [bool(one) for one in passed])
    assert (round(fit.intercept, 4), round(fit.slope, 4)) == (-4.0777, 1.5046)


def test_half_survival_point_and_its_interval() -> None:
    rng = np.random.default_rng(5)
    x = np.repeat([0.5, 0.6, 0.65, 0.7, 0.8, 0.9], 40)
    y = rng.random(x.size) < LogisticFit(-28.0, 40.0).probability(x)
    estimate = half_survival_point(x, y, np.tile(np.arange(40), 6), rng, 300)
    assert estimate.low < 0.7 < estimate.high
    assert estimate.high - estimate.low < 0.04


def test_half_survival_point_of_a_perfect_threshold_is_finite() -> None:
    x = [0.6] * 10 + [0.7] * 10
    estimate = half_survival_point(x, [False] * 10 + [True] * 10, range(20), np.random.default_rng(0), 200)
    assert 0.6 < estimate.value < 0.7
    assert math.isnan(half_survival_point(x, [True] * 20, range(20), np.random.default_rng(0)).value)


def test_half_survival_point_knows_that_flights_of_a_seed_are_alike() -> None:
    """Each vehicle has a threshold of its own: as often as its flight is repeated, the interval stays as wide."""
    thresholds = np.random.default_rng(6).normal(0.7, 0.05, 30)
    x = np.tile([0.6, 0.65, 0.7, 0.75, 0.8], 30)
    seeds = np.repeat(np.arange(30), 5)
    once = half_survival_point(x, x > thresholds[seeds], seeds, np.random.default_rng(0), 300)
    x, seeds = np.tile(x, 4), np.tile(seeds, 4)
    fourfold = half_survival_point(x, x > thresholds[seeds], seeds, np.random.default_rng(0), 300)
    apart = half_survival_point(x, x > thresholds[seeds], np.arange(x.size), np.random.default_rng(0), 300)
    assert fourfold.high - fourfold.low == pytest.approx(once.high - once.low, rel=0.1)
    assert apart.high - apart.low < 0.75 * (once.high - once.low)
