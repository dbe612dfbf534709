"""The shared parts of the benchmarks on recorded flights."""

import numpy as np
import pytest

from async_dmrac.benchmarks.recordings import (
    AHEAD_S,
    Samples,
    compare,
    filled,
    fit_lag,
    lagged,
    same_rate,
    slope,
)


def test_a_prediction_knows_nothing_of_the_last_ahead_s() -> None:
    """A step of the residual stays whole for AHEAD_S, whatever predicts it."""
    rate_hz, n = 50.0, 300
    late = round(AHEAD_S * rate_hz)
    rng = np.random.default_rng(1)
    noise = Samples("noise", rate_hz, rng.standard_normal((n, 2)), 0.01 * rng.standard_normal((n, 1)))
    step = np.zeros((n, 1))
    step[-late:] = 1.0  # seen by no prediction of this flight
    flights = [Samples("step", rate_hz, noise.signals, step), Samples("none", rate_hz, noise.signals, 0.0 * step)]
    left, quiet = compare([noise], flights, ("a", "b"), ("y",), rounds=1)
    whole = float(np.sqrt(late / n))
    assert left.zero == pytest.approx(whole)
    assert left.bias == pytest.approx(whole)
    assert left.untrained == pytest.approx(whole, rel=1e-6)
    assert left.adapted == pytest.approx(np.hypot(whole, quiet.adapted), rel=0.05)


def test_slope_lag_and_fill() -> None:
    t = np.arange(100) * 0.01
    found = slope(np.column_stack([3.0 * t, t**2]), t)
    assert np.isnan(found[:5]).all()
    assert found[5:-5] == pytest.approx(np.column_stack([np.full(90, 3.0), 2.0 * t[5:-5]]))
    step = np.where(t < 0.3, 1.0, 2.0)[:, None]
    answer = lagged(step, 100.0, 0.05)
    assert answer[:30] == pytest.approx(1.0)
    assert answer[34, 0] == pytest.approx(2.0 - np.exp(-1.0), abs=1e-9)  # 0.05 s after the step
    assert filled(np.array([np.nan, 1.0, np.nan, 3.0])).tolist() == [1.0, 1.0, 1.0, 3.0]
    assert same_rate([100.0, 99.0, 50.0]) == [True, True, False]


def test_the_lag_that_fits_best_is_found() -> None:
    commands = np.random.default_rng(2).standard_normal((400, 1))
    truth = 2.5 * lagged(commands, 100.0, 0.07)[:, 0]
    lag_s, gains = fit_lag(lambda lag: (lagged(commands, 100.0, lag), truth))
    assert lag_s == pytest.approx(0.07)
    assert gains == pytest.approx([2.5])
