"""The filter's mean and covariance: textbook equations, symmetry and positive definiteness in float32, no wind-up."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from configs.parts import part_names, read_part
from onboard.control.laws.kalman_last_layer import KalmanConfig, prior_variance
from onboard.control.laws.kalman_state import KalmanState, rounding_share

DT = 0.005
SETTINGS = {"deadline": None, "derandomize": True}


def started(n, seed=0, dtype=np.float64):
    """A state with random theta, X and positive definite S below S0."""
    rng = np.random.default_rng(seed)
    variance, rates = rng.uniform(0.2, 3.0, n).astype(dtype), rng.uniform(0.02, 3.0, n)
    state = KalmanState(rng.normal(size=(n, 3)), variance, rates)
    root = rng.normal(size=(n, n)) / n
    half = np.diag(np.sqrt(variance))
    S = half @ np.linalg.inv(np.eye(n) + root @ root.T * 20.0) @ half
    state.S[:] = 0.5 * (S + S.T)
    state.X_rows[:] = rng.normal(size=(3, n))
    return state, variance, rates, rng


@settings(max_examples=40, **SETTINGS)
@given(st.integers(1, 24), st.integers(0, 2**32 - 1), st.floats(1e-3, 0.1), st.floats(0.01, 100.0))
def test_a_step_is_the_textbook_kalman_filter(n, seed, dt, R):
    state, variance, rates, rng = started(n, seed)
    X, S, phi, y = state.X_rows.T.copy(), state.S.copy(), rng.normal(size=n), rng.normal(size=3)
    D = np.diag(np.exp(-rates * dt))
    X, S = D @ X, D @ S @ D + np.diag((1.0 - np.exp(-2.0 * rates * dt)) * variance)
    K = S @ phi / (R + phi @ S @ phi)
    X_plus, S_plus = X + np.outer(K, y - X.T @ phi), (np.eye(n) - np.outer(K, phi)) @ S

    state.predict(dt)
    np.testing.assert_allclose(state.X_rows.T, X, atol=1e-12)
    np.testing.assert_allclose(state.S, S, atol=1e-12)
    along = state.along(phi[:, None])[:, 0]
    g = along[6:]
    state.correct(g, (y - along[3:6]).tolist(), R + float(phi @ g))
    np.testing.assert_allclose(state.X_rows.T, X_plus, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(state.S, S_plus, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(np.linalg.inv(state.S), np.linalg.inv(S) + np.outer(phi, phi) / R, rtol=1e-6, atol=1e-6)


def test_without_measurements_it_returns_to_its_prior_and_does_not_wind_up():
    state, variance, _, _ = started(6)
    for _ in range(2000):
        state.predict(1.0)
        assert np.linalg.eigvalsh(np.diag(variance) - state.S)[0] > -1e-9
    np.testing.assert_allclose(state.S, np.diag(variance), atol=1e-6)
    np.testing.assert_allclose(state.X_rows, 0.0, atol=1e-6)


def run(steps, dtype, n=21, R=0.09, seed=3):
    """Smallest eigenvalue and largest asymmetry of S over a flight of features that repeat, rest and turn over."""
    config = KalmanConfig(
        kind="kalman", tracking_gain=0.0, composite_gain=20.0, noise=R**0.5, prior=0.8, fast_bias=0.5, prior_rate=0.03,
        fast_bias_rate=2.0, weight_norm_max=40.0,
    )  # fmt: skip
    rng = np.random.default_rng(seed)
    variance, rates = prior_variance(config, n - 1).astype(dtype), np.append(np.full(n - 1, 0.03), 2.0)
    state = KalmanState(np.zeros((n, 3)), variance, rates)
    turn = rng.uniform(0.1, 6.0, n)
    least, asymmetry, largest = np.inf, 0.0, 0.0
    for step in range(steps):
        phi = np.tanh(2.0 * np.sin(turn * (step // 7) * DT + turn)).astype(dtype)
        if step // 20_000 % 3 == 1:
            phi = np.ones(n, dtype=dtype)  # nothing changes for 100 s
        phi[-2:] = 1.0
        state.predict(DT)
        g = state.along(phi[:, None])[6:, 0]
        state.correct(g, [0.0, 0.0, 0.0], float(R) + float(phi @ g))
        if step % 997 == 0 or step == steps - 1:
            S = state.S.astype(np.float64)
            values = np.linalg.eigvalsh(S)
            least, largest = min(least, values[0]), max(largest, values[-1])
            asymmetry = max(asymmetry, float(np.abs(S - S.T).max()))
    return least, asymmetry, largest, variance


@pytest.mark.parametrize("steps", [100_000, pytest.param(10_000_000, marks=pytest.mark.full)])
def test_s_stays_symmetric_and_positive_definite_in_float32(steps):
    """With noise as small as the prior allows: the condition number of S is the largest that the law can meet."""
    least, asymmetry, largest, variance = run(steps, np.float32)
    assert asymmetry == 0.0
    assert least > 1e-5
    assert largest <= float(variance.max()) * 1.001


def test_the_same_steps_in_double_precision_end_at_the_same_s():
    assert run(20_000, np.float32)[0] == pytest.approx(run(20_000, np.float64)[0], rel=0.02)


def kalman_laws():
    for name in part_names("controllers"):
        for channel in ("position", "attitude"):
            law = read_part("controllers", name)["settings"].get(channel, {}).get("augmentation", {}).get("law", {})
            if law.get("kind") == "kalman":
                yield pytest.param(law, id=f"{name}-{channel}")


@pytest.mark.parametrize("law", list(kalman_laws()))
def test_rounding_in_float32_cannot_take_the_floor_of_the_shipped_covariances(law):
    config = KalmanConfig(**law)
    rates = np.append(np.full(20, config.prior_rate), config.fast_bias_rate)
    assert rounding_share(prior_variance(config, 20), rates, config.noise**2, DT) < 1.0


def test_rounding_would_take_the_floor_without_mean_reversion():
    """What restores S is the prediction: with a rate of nearly zero, the guarantee is gone."""
    variance, rates = np.full(21, 0.64), np.full(21, 1e-7)
    assert rounding_share(variance, rates, 0.09, DT) > 1.0
