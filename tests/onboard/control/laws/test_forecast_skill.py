"""The share of a map's look-ahead that is flown: what came true of its changes, and nothing else."""

import numpy as np
import pytest

from onboard.control.laws.forecast_skill import ForecastSkill

DT = 0.005
VARIANCE = 1.0
TIME_S = np.arange(0.0, 30.0, DT)
GUST = np.sin(2.0 * np.pi * 1.3 * TIME_S)


def skill_of(residual: np.ndarray, of_map: np.ndarray) -> float:
    """g at the end, with noise of the declared variance on the residual."""
    one, noise = ForecastSkill(VARIANCE, 1), np.random.default_rng(1).normal(0.0, VARIANCE**0.5, residual.size)
    for r, m in zip((residual + noise).tolist(), of_map.tolist(), strict=True):
        one.step([r], [m], DT)
    return one.shares[0]


def smooth_noise(size: int, seed: int) -> np.ndarray:
    """As fast as GUST, and without any relation to it."""
    rng = np.random.default_rng(seed)
    frequencies, phases = rng.uniform(0.8, 2.0, 12), rng.uniform(0.0, 2.0 * np.pi, 12)
    return np.sin(2.0 * np.pi * frequencies * TIME_S[:size, None] + phases).sum(axis=1) / 6.0**0.5


@pytest.mark.parametrize(("size", "share"), [(1.0, 1.0), (2.0, 0.5), (0.5, 1.0), (-1.0, 0.0)])
def test_it_is_the_part_of_the_change_that_came_true(size: float, share: float) -> None:
    """A map with twice the change counts half; one with half of it is not raised."""
    assert skill_of(GUST, size * GUST) == pytest.approx(share, abs=0.06)


@pytest.mark.parametrize("seed", range(5))
def test_a_map_of_noise_counts_little(seed: int) -> None:
    assert skill_of(GUST, smooth_noise(GUST.size, seed)) < 0.25
    assert skill_of(np.zeros(GUST.size), 0.1 * smooth_noise(GUST.size, seed)) < 0.35


def test_what_the_law_follows_by_itself_is_no_skill() -> None:
    """A drift with a period of 20 s, by map and residual alike."""
    drift = 0.05 * np.sin(2.0 * np.pi * TIME_S / 20.0)
    assert skill_of(drift, drift) < 0.3
    assert skill_of(drift + GUST, drift - GUST) == 0.0


def test_a_strong_disturbance_counts_more_than_the_still_air_before_and_after_it() -> None:
    """A jet of 1 s in a lap of 6 s, that the map has right; elsewhere the map is of noise."""
    in_jet = TIME_S % 6.0 < 1.0
    jet = np.where(in_jet, 2.0 * np.sin(np.pi * (TIME_S % 6.0)), 0.0)
    assert skill_of(jet, jet + 0.1 * smooth_noise(TIME_S.size, 7)) > 0.9


def test_the_step_to_another_map_is_no_change_that_either_foretold() -> None:
    counted, told = ForecastSkill(VARIANCE, 1), ForecastSkill(VARIANCE, 1)
    for one in (counted, told):
        for _ in range(200):
            one.step([0.0], [1.0], DT)
    told.restart()
    for one in (counted, told):
        one.step([-5.0], [-5.0], DT)
    assert counted.shares[0] > 0.0
    assert told.shares[0] == 0.0


def test_nothing_is_flown_ahead_that_has_not_come_true() -> None:
    one = ForecastSkill(VARIANCE, 3)
    assert one.shares == [0.0, 0.0, 0.0]
    one.step([1.0, 1.0, 1.0], [0.0, 0.0, 0.0], DT)
    assert one.shares == [0.0, 0.0, 0.0]
