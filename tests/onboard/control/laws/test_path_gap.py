"""The gap passes what the law does to a residual: a slope of the map over the state is then no feedback."""

import numpy as np
import pytest

from onboard.control.laws.kalman_last_layer import KalmanLastLayer
from onboard.control.laws.path_gap import PathGap
from tests.onboard.control.laws.test_kalman_last_layer import PAIRS, PB, config, features
from tests.onboard.control.laws.test_last_layer import DT

SHARE, KEEP, T = 0.1, 0.99, 3.0


def test_a_deviation_that_stays_is_commanded_in_full() -> None:
    gap = PathGap(PB, PAIRS)
    for _ in range(2000):
        gap.step([1.0, -2.0, 0.0], SHARE, 1.0, T, DT)
    np.testing.assert_allclose(gap.values, [1.0, -2.0, 0.0], atol=1e-3)


def test_closed_it_holds_the_whole_deviation_and_open_none() -> None:
    gap = PathGap(PB, PAIRS)
    gap.close([1.0, 2.0, 3.0])
    assert gap.values == [1.0, 2.0, 3.0]
    gap.close()
    assert gap.values == [0.0, 0.0, 0.0]


def followed(tracking: bool, slope: float = 40.0) -> float:
    """The largest of nu_cmd that a motion beside the path makes, of a plant whose Delta is zero and a map with a slope.

    The map says slope * x at the vehicle and 0 on the path. x swings by 10 mm; e is the error of the reference model,
    which follows nu - Delta. All that is left of the slope in nu_cmd is feedback.
    """
    law = KalmanLastLayer(
        config(tracking_gain=400.0, composite_gain=4.0, noise=0.01, fast_bias=5.0, prior=0.01), 2, PB, PAIRS
    )
    theta = np.array([[slope] * 3, [0.0] * 3])
    law.replace(theta, theta)
    if not tracking:
        law._gap._axes = tuple((k_1, k_2, 0.0, 0.0) for k_1, k_2, _, _ in law._gap._axes)
    (k_1, k_2), e, e_dot, nu, worst = PAIRS[0], 0.0, 0.0, 0.0, 0.0
    for tick in range(4000):
        x = 0.01 * np.sin(2.0 * np.pi * 0.8 * tick * DT)
        Phi = np.array([[x, 0.0, 0.0], [1.0, 1.0, 1.0]])
        e_dot += DT * (nu - k_1 * e - k_2 * e_dot)
        e += DT * e_dot
        now, ahead = law.step(Phi, np.array([e, e, e, e_dot, e_dot, e_dot]), [0.0] * 3, DT)[0]
        nu = float(now)
        worst = max(worst, abs(float(ahead))) if tick > 2000 else worst
    return worst / (0.01 * slope)


def test_with_the_tracking_term_in_it_nothing_of_a_slope_is_fed_back() -> None:
    assert followed(tracking=True) < 0.03
    assert followed(tracking=False) > 0.2


@pytest.mark.parametrize("dt", [0.002, 0.05, 0.5])
def test_it_settles_at_any_length_of_a_tick(dt: float) -> None:
    gap = PathGap(PB, PAIRS)
    for _ in range(round(60.0 / dt)):
        gap.step([1.0, 1.0, 1.0], min(4.0 * dt, 0.9), 1.0, 1.0, dt)
    np.testing.assert_allclose(gap.values, 1.0, atol=1e-2)


@pytest.mark.parametrize("seed", range(3))
def test_the_law_keeps_it_finite_with_any_input(seed: int) -> None:
    rng, law = np.random.default_rng(seed), KalmanLastLayer(config(), 6, PB, PAIRS)
    for _ in range(300):
        law.step(features(rng), 10.0 * rng.normal(size=6), (100.0 * rng.normal(size=3)).tolist(), 0.1 * rng.uniform())
    assert np.isfinite(law.estimate(features(rng))).all()
