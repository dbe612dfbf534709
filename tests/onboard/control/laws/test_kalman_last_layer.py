"""The last-layer law with a covariance: gains and their limit, projection, confidence, and safety with any input."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from configs.loader import ConfigError, fill, merge, set_path
from configs.parts import read_part
from onboard.control.laws.adaptive import AdaptiveConfig
from onboard.control.laws.kalman_last_layer import (
    KalmanConfig,
    KalmanLastLayer,
    confidence,
    evaluate,
    fade,
    prior_variance,
    project,
)
from onboard.control.laws.last_layer import tracking_weights
from tests.onboard.control.laws.test_last_layer import DT, SETTINGS, double_integrator, triple

K = 6
PB = tracking_weights(double_integrator()[2], (4.0, 4.0, 4.0))
PAIRS = [(16.0, 6.4)] * 3
"""K_1, K_2 of that plant."""


def config(**over):
    values = {
        "kind": "kalman", "tracking_gain": 50.0, "composite_gain": 20.0, "noise": 0.5, "prior": 0.8, "fast_bias": 0.5,
        "prior_rate": 0.03, "fast_bias_rate": 2.0, "weight_norm_max": 40.0,
    }  # fmt: skip
    return KalmanConfig(**{**values, **over})


def law(k=K, **over):
    return KalmanLastLayer(config(**over), k, PB, PAIRS)


def features(rng, k=K):
    Phi = np.tanh(rng.normal(size=(k, 3)))
    Phi[-1] = 1.0
    return Phi


def flown(seed, ticks=200, **over):
    """A law that has followed a disturbance for a while, and the features of the last tick."""
    rng, one = np.random.default_rng(seed), law(**over)
    theta = rng.normal(size=(K, 3))
    one.replace(theta, theta)
    for _ in range(ticks):
        Phi = features(rng)
        one.step(Phi, 0.01 * rng.normal(size=6), (2.0 * Phi[:3, 0] + rng.normal(size=3)).tolist(), DT)
    return one, Phi, rng


# --- gain ------------------------------------------------------------------------------------------------------------


@settings(max_examples=60, **SETTINGS)
@given(
    st.integers(0, 2**32 - 1), st.floats(0.1, 100.0), st.floats(1e-3, 1e2), st.floats(1e-2, 1e2), st.floats(1e-2, 1e2)
)
def test_nu_never_follows_the_residual_faster_than_the_composite_gain(seed, gain, noise, prior, fast_bias):
    """Whatever R and S0 are: the bandwidth of the loop has a limit of its own."""
    rng = np.random.default_rng(seed)
    one = law(
        composite_gain=gain, noise=noise, prior=prior, fast_bias=fast_bias, tracking_gain=0.0, weight_norm_max=1e9
    )
    for _ in range(5):
        Phi, r = features(rng), 10.0 * rng.normal(size=3)
        one.state.predict(DT)
        before = one.estimate(Phi)[:, 0]
        undo = one.state._keep.copy()
        one.state._keep[:], gained = 1.0, one.state._gain.copy()
        one.state._gain[:] = 0.0
        after = one.step(Phi, np.zeros(6), r.tolist(), DT)[:, 0]
        one.state._keep[:], one.state._gain[:] = undo, gained
        share = (after - before) / (r - before)
        assert (share > 0.0).all()
        assert (share <= gain * DT / (1.0 + gain * DT) * (1.0 + 1e-9)).all()


def test_without_the_limit_the_gain_follows_the_prior():
    rng = np.random.default_rng(0)
    one, Phi = law(composite_gain=1e3, prior=50.0, tracking_gain=0.0), features(rng)
    nu = one.step(Phi, np.zeros(6), [1.0, 1.0, 1.0], DT)[:, 0]
    assert (nu > 0.8).all()


def test_where_the_limit_does_not_bind_a_tick_is_the_textbook_filter():
    one, _, rng = flown(1, noise=5.0)
    Phi, r = features(rng), rng.normal(size=3)
    X, S = one.state.X_rows.T.copy(), one.state.S.copy()
    d = np.append(np.full(K, np.exp(-0.03 * DT)), np.exp(-2.0 * DT))
    X, S = d[:, None] * X, d[:, None] * d * S + np.diag((1.0 - d**2) * prior_variance(one.config, K))
    phi = np.append(Phi[:, 0], 1.0)
    gain = S @ phi / (25.0 + phi @ S @ phi)
    X += np.outer(gain, r - one.theta.T @ Phi[:, 0] - X.T @ phi)
    nu = one.step(Phi, np.zeros(6), r.tolist(), DT)
    np.testing.assert_allclose(one.state.X_rows.T, X, atol=1e-12)
    np.testing.assert_allclose(one.state.S, S - np.outer(gain, phi @ S), atol=1e-12)
    np.testing.assert_allclose(nu[:, 0], one.W.T @ Phi[:, 0] + one.b, atol=1e-12)
    np.testing.assert_allclose(nu, one.estimate(Phi), atol=1e-12)


def test_the_tracking_term_moves_nu_against_e_at_its_stated_rate():
    one, Phi = law(noise=0.01), features(np.random.default_rng(2))
    e = np.array([0.02, 0.0, 0.0, 0.0, 0.0, 0.0])
    nu = one.step(Phi, e, [0.0, 0.0, 0.0], DT)[:, 0]
    np.testing.assert_allclose(nu, -50.0 * DT * (e @ PB) / (1.0 + 20.0 * DT), rtol=0.02, atol=1e-12)


def test_a_constant_disturbance_is_cancelled_but_for_the_mean_reversion():
    """nu settles at 1 / (1 + 1 / (k_w / s_w + k_b / s_b)) of it."""
    one, Phi = law(), features(np.random.default_rng(3))
    for _ in range(8000):
        nu = one.step(Phi, np.zeros(6), [1.0, -2.0, 3.0], DT)
    np.testing.assert_allclose(nu[:, 0], [1.0, -2.0, 3.0], rtol=0.01)


def test_no_gain_changes_nothing():
    one, Phi, rng = flown(4)
    frozen = law(composite_gain=0.0, tracking_gain=0.0)
    frozen.adopt(one.theta, one.state.X_rows.T, one.state.S)
    before = frozen.estimate(Phi)
    for _ in range(10):
        np.testing.assert_array_equal(frozen.step(Phi, rng.normal(size=6), [9.0, 9.0, 9.0], DT), before)


# --- projection, guard -----------------------------------------------------------------------------------------------


@settings(max_examples=60, **SETTINGS)
@given(
    st.lists(st.tuples(triple, triple, triple, st.floats(-1.0, 1.0)), min_size=1, max_size=12), st.floats(0.1, 100.0)
)
def test_the_state_stays_in_its_ball_whatever_comes_in(steps, radius):
    one = law(4, tracking_gain=1e4, composite_gain=1e3, noise=1e-3, prior=10.0, weight_norm_max=radius)
    with np.errstate(all="ignore"):
        for first, second, residual, phi in steps:
            Phi = np.array([[phi, phi, 0.1], [-phi, 0.5, phi], [0.3, 0.3, 0.3], [1.0, 1.0, 1.0]])
            one.step(Phi, np.array([*first, *second]), list(residual), DT)
            X = one.state.X_rows
            assert np.isfinite(X).all()
            assert np.isfinite(one.state.S).all()
            assert np.linalg.norm(X) <= radius * (1.0 + 1e-9)
            assert one.weight_norm == pytest.approx(float(np.linalg.norm(one.W)), abs=1e-6 * radius)


def test_the_norm_is_right_after_a_step_that_was_left_out():
    """The state decays in every step, a residual that is no number or not."""
    one, Phi, _ = flown(4)
    one.step(Phi, np.zeros(6), [np.nan, 0.0, 0.0], 1.0)
    assert one.weight_norm == pytest.approx(float(np.linalg.norm(one.W)), rel=1e-9)


def test_without_the_projection_the_state_leaves_its_ball():
    one = law(weight_norm_max=1.0, composite_gain=1e3)
    one._keep_in_ball = lambda: None
    one.step(features(np.random.default_rng(0)), np.zeros(6), [1e6, 1e6, 1e6], DT)
    assert np.linalg.norm(one.state.X_rows) > 10.0


@settings(max_examples=100, **SETTINGS)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 2.0))
def test_projection_never_adds_to_v(seed, spread):
    """tr(X~'S^-1 X~) does not grow for any X* in the ball: what the stability proof needs."""
    rng = np.random.default_rng(seed)
    n, radius = 5, 2.0
    axes = np.linalg.qr(rng.normal(size=(n, n)))[0]
    S = axes @ np.diag(np.exp(spread * rng.normal(size=n))) @ axes.T
    X, X_star = rng.normal(size=(3, n)), rng.normal(size=(3, n))
    X *= rng.uniform(0.5, 6.0) * radius / np.linalg.norm(X)
    X_star *= rng.uniform(0.0, 1.0) * radius / np.linalg.norm(X_star)
    Y = project(X, S, radius)
    inverse = np.linalg.inv(S)

    def V(state):
        return float(((state - X_star) @ inverse * (state - X_star)).sum())

    assert V(Y) <= V(X) * (1.0 + 1e-9)
    if np.linalg.norm(X) <= radius:
        np.testing.assert_array_equal(Y, X)
    else:  # the nearest point of the ball in that metric: S^-1 (X - Y) is along Y
        assert np.linalg.norm(Y) == pytest.approx(radius, rel=1e-6)
        outward = (X - Y) @ inverse
        cosine = float((outward * Y).sum() / np.linalg.norm(outward) / np.linalg.norm(Y))
        assert cosine == pytest.approx(1.0, abs=1e-6)


def test_scaling_instead_of_projecting_adds_to_v():
    S = np.diag([1e-4, 1.0])
    X, X_star = np.array([[1.0, 3.0]]), np.array([[1.0, 0.0]])
    inverse = np.linalg.inv(S)

    def V(state):
        return float(((state - X_star) @ inverse * (state - X_star)).sum())

    assert V(X / np.linalg.norm(X)) > 10.0 * V(X)
    assert V(project(X, S, 1.0)) <= V(X)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_step_that_is_not_finite_is_left_out(bad):
    one, Phi, _ = flown(5)
    X, S = one.state.X_rows.copy(), one.state.S.copy()
    with np.errstate(all="ignore"):
        one.step(Phi, np.zeros(6), [bad, 0.0, 0.0], DT)
        one.step(np.full_like(Phi, bad), np.zeros(6), [0.0, 0.0, 0.0], DT)
    np.testing.assert_allclose(one.state.X_rows, X, rtol=0.1, atol=1e-3)
    np.testing.assert_allclose(one.state.S, S, rtol=0.1, atol=1e-3)


# --- confidence ------------------------------------------------------------------------------------------------------


def bumps(places):
    """Gaussians along a line of 6 m, and the constant: a map that is local."""
    centres = np.linspace(0.0, 6.0, 19)
    return np.vstack([np.exp(-((np.asarray(places)[None] - centres[:, None]) ** 2) / 0.18), np.ones(len(places))])


def along_the_line(**over):
    """A law that has flown to and fro over the first 2 m, on a disturbance that the map there explains, to 1."""
    one = KalmanLastLayer(config(noise=0.3, prior=1.5, fast_bias=0.1, **over), 20, PB, PAIRS)
    theta = np.zeros((20, 3))
    theta[-1] = 0.5  # the trained map: 0.5 everywhere
    one.replace(theta, theta)
    for tick in range(6000):
        place = 1.0 - np.cos(tick * DT)
        one.step(bumps([place, place, place]), np.zeros(6), [1.0 + np.sin(3.0 * place)] * 3, DT)
    return one


def test_far_from_data_the_map_fades_to_its_prior():
    """On a path that leaves the region where the law has learnt, nu ahead goes to the trained map and the fast bias."""
    one = along_the_line()
    known, unknown, prior = [], [], one.theta.T @ bumps([1.0]) + one.b[:, None]
    for place in (0.5, 1.0, 1.5):
        nu = one.estimate(bumps([1.0, place, 1.0]))[:, 1]
        known.append(np.abs(nu - (1.0 + np.sin(3.0 * place))).max())
    for place in (3.5, 4.5, 5.5):
        nu = one.estimate(bumps([1.8, place, 1.8]))[:, 1]
        unknown.append(np.abs(nu - prior[:, 0]).max())
    assert max(known) < 0.15
    assert max(unknown) < 0.25 * np.abs(one.W.T @ bumps([4.5]) + one.b[:, None] - prior).max() + 0.02
    assert max(unknown) < 0.12


def test_without_confidence_what_was_learnt_here_is_taken_there():
    """The slow constant has learnt the mean of the known region; without a prior's say it is believed everywhere."""
    faded, plain = along_the_line(), along_the_line(confidence=False)
    prior = (faded.theta.T @ bumps([1.0]) + faded.b[:, None])[:, 0]
    there = bumps([1.8, 4.5, 1.8])
    assert np.abs(plain.estimate(there)[:, 1] - prior).max() > 2.0 * np.abs(faded.estimate(there)[:, 1] - prior).max()


def test_at_the_present_state_nothing_fades():
    one, Phi, _ = flown(6)
    np.testing.assert_allclose(one.estimate(Phi)[:, 0], one.W.T @ Phi[:, 0] + one.b, atol=1e-12)


@settings(max_examples=60, **SETTINGS)
@given(st.integers(0, 2**32 - 1))
def test_confidence_is_a_share_and_the_fade_as_well(seed):
    one, _, rng = flown(seed, ticks=30)
    c = confidence(one.state.S, one.state.prior_variance, features(rng)[:, :2])
    assert (c >= -1e-9).all()
    assert (c <= 1.0).all()
    assert 0.0 <= fade(*c.tolist()) <= 1.0
    assert evaluate(one.config, one.theta, one.state.X_rows.T, one.state.S, features(rng)).shape == (3, 3)


# --- the map is no feedback -------------------------------------------------------------------------------------------


def swing(slope, ticks=2000, read="as built"):
    """Positions [ticks] of a double integrator that is pushed at the start, with a map nu = slope x that is all wrong.

    The path stands at x = 0. There is no disturbance, so the bias has to take up what the map says.
    """
    one = law(2, tracking_gain=0.0, prior=1e-3, fast_bias=3.0, noise=0.3)
    theta = np.zeros((2, 3))
    theta[0] = slope
    one.replace(theta, theta)
    x, v, xs, k1, k2 = 0.0, 0.3, [], 10.0, 4.0
    for _ in range(ticks):
        ahead, path = {"as built": (0.0, 0.0), "path": (0.0, x), "vehicle": (x, x)}[read]
        Phi = np.array([[x, ahead, path], [1.0, 1.0, 1.0]])
        nu = one.step(Phi, np.zeros(6), [0.0, 0.0, 0.0], DT)[0, 1]
        v += DT * (-k1 * x - k2 * v - nu)
        x += DT * v
        xs.append(x)
    return np.array(xs)


@pytest.mark.parametrize("slope", [-60.0, -10.0, 10.0, 60.0])
def test_a_wrong_slope_of_the_map_does_not_change_the_loop(slope):
    """Six times the stiffness of the loop, with either sign."""
    plain, steep = swing(0.0), swing(slope)
    assert np.abs(steep - plain).max() < 0.02 * np.abs(plain).max()


@pytest.mark.parametrize("slope", [-60.0, 60.0])
@pytest.mark.parametrize("read", ["path", "vehicle"])
def test_without_the_filter_of_the_gap_it_does(slope, read):
    """Ablations: the map on the path alone, and the map at the vehicle alone."""
    plain = swing(0.0)
    assert np.abs(swing(slope, read=read) - plain).max() > 0.3 * np.abs(plain).max()


# --- configuration ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("key", "value", "allowed"),
    [
        ("noise", 0.0, "greater than 0"),
        ("prior", -1.0, "greater than 0"),
        ("prior_rate", 0.0, "greater than or equal to 0.003"),
        ("composite_gain", -1.0, "greater than or equal to 0"),
        ("weight_norm_max", 0.0, "greater than 0"),
    ],
)
def test_values_out_of_range_are_refused_by_name(key, value, allowed):
    with pytest.raises(ValidationError, match=f"(?s){key}.*{allowed}"):
        config(**{key: value})


def augmentation_of(name):
    return read_part("controllers", name)["settings"]["position"]["augmentation"]


def test_the_keys_of_the_other_law_are_refused():
    tree = merge(augmentation_of("dmrac"), {"law": {"bias_weight": 3.0}})
    with pytest.raises(ConfigError, match=r"law.*bias_weight"):
        fill(AdaptiveConfig, tree, "test")


def test_an_unknown_law_is_refused_with_what_is_allowed():
    with pytest.raises(ConfigError, match=r"(?s)law.*gradient.*kalman"):
        fill(AdaptiveConfig, merge(augmentation_of("mrac"), {"law": {"kind": "magic"}}), "test")


def test_one_setting_gives_another_controller_this_law():
    law_of_dmrac = augmentation_of("dmrac")["law"]
    tree = set_path({"augmentation": augmentation_of("mrac")}, f"augmentation.law={law_of_dmrac}")
    filled = fill(AdaptiveConfig, tree["augmentation"], "test")
    assert isinstance(filled.law, KalmanConfig)
    assert filled.features == "rbf"
