"""The last-layer law: its sign, its Lyapunov function, its projection, and its safety in discrete time."""

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.control.laws.last_layer import (
    PROJECTION_MARGIN,
    AdaptationConfig,
    LastLayer,
    lyapunov_p,
    projected_rate,
)
from onboard.control.reference_model import ChannelGains

DT = 0.005
BALL = (1.0 + PROJECTION_MARGIN) ** 0.5
SETTINGS = {"deadline": None, "derandomize": True}


def config(**over):
    values = {"tracking_gain": 100.0, "composite_gain": 10.0, "bias_weight": 1.0, "leak": 0.0, "weight_norm_max": 50.0}
    return AdaptationConfig(**{**values, **over})


def double_integrator(omega_n=4.0, damping=0.8, error_weight=(1.0, 0.1)):
    gains = ChannelGains(natural_frequency_rad_s=(omega_n,) * 3, damping=damping)
    A_rm, Q = gains.closed_loop_matrix(), np.diag(np.repeat(error_weight, 3))
    return A_rm, Q, lyapunov_p(A_rm, Q)


# --- Lyapunov equation ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(5))
def test_lyapunov_p_equals_scipy(seed):
    rng = np.random.default_rng(seed)
    A_rm = rng.normal(size=(6, 6)) - 6.0 * np.eye(6)
    root = rng.normal(size=(6, 6))
    Q = root @ root.T + 0.1 * np.eye(6)
    P = lyapunov_p(A_rm, Q)
    np.testing.assert_allclose(P, scipy.linalg.solve_continuous_lyapunov(A_rm.T, -Q), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(A_rm.T @ P + P @ A_rm, -Q, atol=1e-10)
    assert np.linalg.eigvalsh(P)[0] > 0.0


def test_scipys_argument_order_is_a_trap():
    """Called with A_rm instead of its transpose, scipy solves another equation: the channels' A_rm is not symmetric."""
    A_rm, Q, P = double_integrator()
    wrong = scipy.linalg.solve_continuous_lyapunov(A_rm, -Q)
    assert np.abs(wrong - P).max() > 0.1 * np.abs(P).max()


def test_lyapunov_p_refuses_an_unstable_reference_model():
    with pytest.raises(ValueError, match="Hurwitz"):
        lyapunov_p(np.diag([-1.0, 0.5]), np.eye(2))


# --- the sign, on wing rock ----------------------------------------------------------------------------------------


def wing_rock_delta(roll, rate):
    """The unstable roll of a slender delta wing (Chowdhary and Johnson 2010), with a trim offset."""
    return (
        0.8 + 0.2314 * roll + 0.6918 * rate - 0.6245 * abs(roll) * rate + 0.0095 * abs(rate) * rate + 0.0214 * roll**3
    )


def fly_wing_rock(sign, composite_gain=0.0, seconds=40.0, adapt=True):
    """Errors e [n, 2] of the roll against a square wave's reference. sign: +1 ours, -1 as the paper prints it."""
    k1, k2 = 1.0, 1.0
    A_rm = np.array([[0.0, 1.0], [-k1, -k2]])
    P = lyapunov_p(A_rm, np.eye(2))
    PB = np.zeros((2, 3))
    PB[:, 0] = sign * P[:, 1]
    law = config(tracking_gain=20.0, composite_gain=composite_gain, weight_norm_max=1e6)
    centres = np.array([(a, b) for a in (-1.0, 0.0, 1.0) for b in (-1.0, 0.0, 1.0)])
    last = LastLayer(law, 10, PB)
    x, x_rm, dt = np.zeros(2), np.zeros(2), 0.005
    errors = []
    for step in range(round(seconds / dt)):
        r = 0.5 if (step * dt) % 20.0 < 10.0 else -0.5
        e = x_rm - x
        errors.append(e)
        if np.abs(e).max() > 1e3:
            break
        Phi = np.append(np.exp(-((x - centres) ** 2).sum(axis=1)), 1.0)
        delta = wing_rock_delta(*x)
        if adapt:
            last.step(Phi, e, np.array([delta, 0.0, 0.0]), dt)
        nu = float(Phi @ last.W[:, 0])
        u = k1 * (r - x[0]) - k2 * x[1] - nu
        x = x + dt * np.array([x[1], u + delta])
        x_rm = x_rm + dt * (A_rm @ x_rm + np.array([0.0, k1 * r]))
    return np.array(errors)


def rms(errors):
    return float(np.sqrt((errors[:, 0] ** 2).mean()))


def test_the_printed_sign_diverges_on_wing_rock_and_ours_does_not():
    ours, printed, none = fly_wing_rock(+1), fly_wing_rock(-1), fly_wing_rock(+1, adapt=False)
    assert len(ours) == 8000
    late = ours[4000:]
    assert rms(late) < 0.1 * rms(none[4000:]), (rms(late), rms(none[4000:]))
    assert np.abs(printed).max() > 1e3
    assert len(printed) < 8000


def test_the_composite_term_helps_on_wing_rock():
    assert rms(fly_wing_rock(+1, composite_gain=10.0)) < 0.5 * rms(fly_wing_rock(+1))


def test_the_printed_law_without_b_has_the_wrong_shape():
    """Phi e'P is [k, n]; W is [k, m]. Only with B does the product fit, unless n = m by accident."""
    Phi, e = np.ones(4), np.ones(6)
    _, _, P = double_integrator()
    B = np.vstack([np.zeros((3, 3)), np.eye(3)])
    assert np.outer(Phi, e @ P).shape == (4, 6)
    assert np.outer(Phi, e @ P @ B).shape == (4, 3)


# --- projection ------------------------------------------------------------------------------------------------------

number = st.one_of(st.floats(-1e3, 1e3), st.sampled_from([1e200, -1e200, np.inf, -np.inf, np.nan]))
triple = st.tuples(number, number, number)


@settings(max_examples=60, **SETTINGS)
@given(
    st.lists(st.tuples(triple, triple, triple, st.floats(-1.0, 1.0)), min_size=1, max_size=12), st.floats(0.1, 100.0)
)
def test_w_stays_in_its_ball_whatever_comes_in(steps, radius):
    _, _, P = double_integrator()
    last = LastLayer(
        config(tracking_gain=1e4, composite_gain=1e3, bias_weight=40.0, weight_norm_max=radius), 4, P[:, 3:]
    )
    with np.errstate(all="ignore"):
        for first, second, residual, phi in steps:
            Phi = np.array([phi, -phi, 0.3, 1.0])
            last.step(Phi, np.array([*first, *second]), np.array(residual), DT)
            assert np.isfinite(last.W).all()
            assert np.linalg.norm(last.W) <= radius * BALL * (1.0 + 1e-9)
            assert last.weight_norm == pytest.approx(float(np.linalg.norm(last.W)))


def test_without_the_safeguards_w_leaves_its_ball():
    _, _, P = double_integrator()
    last = LastLayer(config(weight_norm_max=1.0), 4, P[:, 3:])
    last._keep_in_ball = lambda: None
    last.step(np.array([1.0, -1.0, 0.3, 1.0]), np.full(6, 1e6), np.full(3, 1e6), DT)
    assert np.linalg.norm(last.W) > 10.0


@settings(max_examples=100, **SETTINGS)
@given(st.integers(0, 2**32 - 1))
def test_projection_never_adds_to_v(seed):
    """tr(W~' Gamma^-1 (Proj(rate) - rate)) <= 0 for every W* within W_max: what the stability proof needs."""
    rng = np.random.default_rng(seed)
    k, W_max = 5, 2.0
    gamma = rng.uniform(0.5, 40.0, k)
    W = rng.normal(size=(k, 3))
    W *= rng.uniform(0.5, 1.2) * W_max * BALL / np.linalg.norm(W)
    W_star = rng.normal(size=(k, 3))
    W_star *= rng.uniform(0.0, 1.0) * W_max / np.linalg.norm(W_star)
    rate = gamma[:, None] * rng.normal(size=(k, 3))
    projected = projected_rate(W, rate, gamma, W_max)
    assert float(((W - W_star) / gamma[:, None] * (projected - rate)).sum()) <= 1e-9
    if np.linalg.norm(W) <= W_max or float(np.vdot(W, rate)) <= 0.0:
        np.testing.assert_array_equal(projected, rate)
    else:  # the outward part shrinks linearly over the layer, to nothing, and never turns inward
        f = (np.linalg.norm(W) ** 2 / W_max**2 - 1.0) / PROJECTION_MARGIN
        left = max(1.0 - f, 0.0) * float(np.vdot(W, rate))
        assert float(np.vdot(W, projected)) == pytest.approx(left, abs=1e-9)


def test_gamma_weighs_the_bias():
    """One step moves W along Gamma Phi; nu moves at the stated rate all the same."""
    _, _, P = double_integrator()
    last = LastLayer(config(tracking_gain=0.0, bias_weight=40.0), 3, P[:, 3:])
    Phi, target = np.array([0.5, -0.25, 1.0]), np.array([1.0, 2.0, -3.0])
    last.step(Phi, np.zeros(6), target, DT)
    np.testing.assert_allclose(last.W / last.W[0], np.array([0.5, -0.25, 40.0])[:, None] / np.full(3, 0.5))
    np.testing.assert_allclose(last.W.T @ Phi, target * 0.05 / 1.05, rtol=1e-4)


def test_new_weights_outside_the_ball_are_clipped_to_it():
    _, _, P = double_integrator()
    last = LastLayer(config(weight_norm_max=1.0, bias_weight=7.0), 4, P[:, 3:])
    last.replace(np.full((6, 3), 10.0), np.zeros((6, 3)))
    assert last.weight_norm == pytest.approx(BALL)
    assert last.gamma.tolist() == [1.0] * 5 + [7.0]


# --- discrete time ---------------------------------------------------------------------------------------------------


@settings(max_examples=60, **SETTINGS)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 1e3), st.floats(1e-4, 0.05))
def test_the_composite_term_never_overshoots(seed, gain, dt):
    rng = np.random.default_rng(seed)
    _, _, P = double_integrator()
    last = LastLayer(config(tracking_gain=0.0, composite_gain=gain, weight_norm_max=1e6, bias_weight=40.0), 5, P[:, 3:])
    Phi = np.append(np.tanh(rng.normal(size=4)), 1.0)
    target = rng.normal(size=3) * 10.0
    gap = np.abs(target)
    for _ in range(5):
        last.step(Phi, np.zeros(6), target, dt)
        nu = last.W.T @ Phi
        assert (nu * target >= -1e-9).all()
        assert (np.abs(target - nu) <= gap + 1e-9).all()
        gap = np.abs(target - nu)


def test_an_explicit_composite_step_would_overshoot():
    """What the implicit form is for: at lambda dt = 5 the explicit one lands at five times the target."""
    gain, dt, target = 1e3, 5e-3, 1.0
    assert gain * dt * target > 4.0
    _, _, P = double_integrator()
    last = LastLayer(config(tracking_gain=0.0, composite_gain=gain, weight_norm_max=1e6), 1, P[:, 3:])
    last.step(np.ones(1), np.zeros(6), np.full(3, target), dt)
    assert 0.8 < last.W[0, 0] < 1.0


@settings(max_examples=60, **SETTINGS)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 1e3), st.floats(0.1, 100.0), st.floats(0.5, 80.0))
def test_a_step_is_an_explicit_step_of_the_law_with_effective_gains(seed, gamma, lambda_, kappa):
    """docs/theory.md: gamma / (1 + gamma p dt^2) for gamma, eps + (1 + lambda dt) Phi'Gamma Phi for m^2."""
    rng = np.random.default_rng(seed)
    _, _, P = double_integrator()
    law = config(tracking_gain=gamma, composite_gain=lambda_, bias_weight=kappa, weight_norm_max=1e6)
    last = LastLayer(law, 5, P[:, 3:])
    W, e, Delta_hat = rng.normal(size=(5, 3)), rng.normal(size=6), rng.normal(size=3)
    last.replace(W, W)
    Phi = np.append(np.tanh(rng.normal(size=4)), 1.0)
    m_d2 = law.normalisation_floor + (1.0 + lambda_ * DT) * float(Phi @ (last.gamma * Phi))
    gamma_d = gamma / (1.0 + gamma * float(np.abs(P[3:, 3:]).max()) * DT**2)
    last.step(Phi, e, Delta_hat, DT)
    rate = -np.outer(last.gamma * Phi, gamma_d * (e @ P[:, 3:]) + lambda_ * (W.T @ Phi - Delta_hat)) / m_d2
    np.testing.assert_allclose(last.W, W + DT * rate, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("active", [1, 4, 20])
def test_the_bandwidth_does_not_depend_on_how_many_features_are_active(active):
    _, _, P = double_integrator()
    last = LastLayer(config(weight_norm_max=1e6), active, P[:, 3:])
    e, residual = np.array([0.1, 0, 0, 0.2, 0, 0]), np.array([1.0, 0, 0])
    Phi = np.ones(active)
    last.step(Phi, e, residual, DT)
    nu = float(Phi @ last.W[:, 0])
    tracking = -DT * 100.0 * float(e @ P[:, 3])
    assert nu == pytest.approx((tracking + 10.0 * DT * residual[0]) / (1.0 + 10.0 * DT), rel=0.01)


def loop_of_error_and_law(last, A_rm, k1, k2, steps, dt):
    """Largest |e| of the sampled loop e_dot = A_rm e + B nu_ad with the bias alone, from e = (1, 0)."""
    e = np.array([1.0, 0, 0, 0, 0, 0])
    largest = 0.0
    for _ in range(steps):
        last.step(np.ones(1), e, np.zeros(3), dt)
        a = last.W[0] - k1 * e[:3] - k2 * e[3:]
        e = np.concatenate([e[:3] + dt * e[3:] + 0.5 * dt * dt * a, e[3:] + dt * a])
        largest = max(largest, float(np.abs(e[:3]).max()))
        if largest > 1e6:
            break
    return largest


@pytest.mark.parametrize("omega_n", [2.0, 4.0, 16.0, 60.0])
@pytest.mark.parametrize("weights", [(1.0, 0.1), (1.0, 100.0), (1e4, 1e4)])
def test_the_tracking_term_is_stable_at_any_gain(omega_n, weights):
    A_rm, _, P = double_integrator(omega_n, 0.8, weights)
    last = LastLayer(config(tracking_gain=1e4, composite_gain=0.0, weight_norm_max=1e9), 1, P[:, 3:])
    assert loop_of_error_and_law(last, A_rm, omega_n**2, 1.6 * omega_n, 2000, DT) < 3.0


def test_an_explicit_tracking_step_would_be_unstable():
    A_rm, _, P = double_integrator(4.0, 0.8, (1e4, 1e4))
    last = LastLayer(config(tracking_gain=1e4, composite_gain=0.0, weight_norm_max=1e9), 1, P[:, 3:])
    last._rate_weight = 0.0
    assert loop_of_error_and_law(last, A_rm, 16.0, 6.4, 2000, DT) > 1e3


@pytest.mark.parametrize("leak", [0.1, 10.0])
def test_the_leak_leads_to_the_trained_last_layer(leak):
    _, _, P = double_integrator()
    last = LastLayer(config(tracking_gain=0.0, composite_gain=0.0, leak=leak), 3, P[:, 3:])
    memory = np.arange(9.0).reshape(3, 3)
    last.replace(np.zeros((3, 3)), memory)
    steps = round(1.0 / leak / DT)
    for _ in range(steps):
        last.step(np.ones(3), np.zeros(6), np.zeros(3), DT)
    share = 1.0 - float(np.exp(-1.0))
    np.testing.assert_allclose(last.W[:-1], share * memory[:-1], rtol=0.03, atol=1e-12)
    np.testing.assert_array_equal(
        last.W[-1], 0.0, err_msg="the bias has no memory: a constant Delta is cancelled entirely"
    )
