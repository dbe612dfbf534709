"""A core whose covariance is in 32-bit whole numbers (-DDMRAC_WHOLE_COVARIANCE), against float and double."""

from typing import Any

import numpy as np
import pytest

from onboard.c.compile import Variant
from onboard.c.library import Core, load
from onboard.control.laws.kalman_last_layer import prior_variance
from tests.onboard.c.conftest import OPTIONS
from tests.onboard.c.parity import view
from tests.onboard.c.test_kalman import kalman_config
from tests.onboard.control.fixture import DT


@pytest.fixture(scope="module")
def whole() -> Core:
    return load(Variant("float", (*OPTIONS, "-DDMRAC_WHOLE_COVARIANCE")))


K = 21
SHIPPED = {"noise": 1.096, "prior": 0.6049, "fast_bias": 3.347, "prior_rate": 0.02475, "fast_bias_rate": 0.8485}


def state_of(core: Core, config: Any, real: Any) -> Any:
    state = core.KalmanState()
    rates = np.full(K + 1, config.prior_rate, real)
    rates[-1] = config.fast_bias_rate
    core.kalman_state_init(state, prior_variance(config, K).astype(real), rates, K + 1)
    return state


def dense(core: Core, state: Any, real: Any) -> Any:
    """S [n, n]."""
    out, rows = np.zeros(K + 1, real), []
    for column in range(K + 1):
        core.kalman_state_column(state, column, out)
        rows.append(out.astype(np.float64))
    return np.array(rows)


def run(core: Core, real: Any, ticks: int, config: Any) -> tuple[Any, Any]:
    """S and X after so many ticks along a path that excites some directions only."""
    state, rng = state_of(core, config, real), np.random.default_rng(3)
    mix = rng.normal(size=(K - 1, 4))
    g, x = np.zeros(K + 1, real), np.zeros(3, real)
    for tick in range(ticks):
        phi = np.ones(K + 1)
        phi[: K - 1] = np.tanh(mix @ np.sin(0.01 * tick * np.arange(1, 5)))
        phi = phi.astype(real)
        core.kalman_state_predict(state, DT)
        core.kalman_state_along(state, phi, K + 1, g, x)
        v = config.noise**2 + float(phi.astype(np.float64) @ g.astype(np.float64))
        innovation = (np.array([1.0, -2.0, 0.5]) * np.sin(0.01 * tick) - x).astype(real)
        core.kalman_state_correct(state, g, innovation, v)
    return dense(core, state, real), view(state.X)[: 3 * (K + 1)].astype(np.float64)


@pytest.mark.parametrize("ticks", [1, 40, 4000])
def test_it_is_the_same_filter(core: Core, core32: Core, whole: Core, ticks: int) -> None:
    """As near to the filter in double as that in float is."""
    config = kalman_config(**SHIPPED)
    exact, exact_X = run(core, np.float64, ticks, config)
    in_float, float_X = run(core32, np.float32, ticks, config)
    S, X = run(whole, np.float32, ticks, config)
    assert np.abs(S - exact).max() <= 3.0 * np.abs(in_float - exact).max() + 1e-6 * exact.max()
    assert np.abs(X - exact_X).max() <= 3.0 * np.abs(float_X - exact_X).max() + 1e-5
    assert np.array_equal(S, S.T)
    roots = np.sqrt(np.diag(exact))
    assert np.linalg.eigvalsh(S / np.outer(roots, roots))[0] > 1e-5


def test_numbers_that_are_not_finite_are_found(whole: Core) -> None:
    """A part of a swap must not fly on them."""
    config = kalman_config(**SHIPPED)
    state = state_of(whole, config, np.float32)
    assert whole.kalman_state_is_finite(state)
    g = np.full(K + 1, np.nan, np.float32)
    whole.kalman_state_correct(state, g, np.zeros(3, np.float32), 1.0)
    assert not whole.kalman_state_is_finite(state)
