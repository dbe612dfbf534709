"""Lyapunov function of the last-layer law: V never grows, the condition on lambda, the radius for e."""

import numpy as np
import pytest
import scipy.linalg

from configs.parts import part_names, read_part
from onboard.control.laws.last_layer import (
    AdaptationConfig,
    LastLayer,
    lyapunov_p,
    tracking_weights,
)
from onboard.control.reference_model import ChannelGains
from tests.onboard.control.laws.test_last_layer import config, double_integrator


def m2_range(law, k):
    """Smallest and largest m^2 = eps + Phi'Gamma Phi of k features of at most 1, the last of them the constant."""
    low = law.normalisation_floor + law.bias_weight
    return low, low + k - 1


def composite_gain_needed(law, PB, Q, k):
    """The smallest lambda for which V cannot grow, by docs/theory.md."""
    low, high = m2_range(law, k)
    rho = (high / low) ** 0.5
    return law.tracking_gain * np.linalg.norm(PB.T @ np.linalg.solve(Q, PB), 2) * (rho - 1.0) ** 2 / (2.0 * rho)


def simulate_inside(law, sign=1.0, seconds=4.0, dt=5e-4, k=8):
    """V after each step: e_dot = A_rm e + B W~'Phi with Phi wandering, Delta = W*'Phi, e and W far off at the start."""
    rng = np.random.default_rng(3)
    A_rm, _, P = double_integrator()
    B = np.vstack([np.zeros((3, 3)), np.eye(3)])
    W_star = rng.normal(size=(k, 3))
    last = LastLayer(law, k, sign * P @ B)
    low, high = m2_range(law, k)
    c = (low * high) ** 0.5
    e = rng.normal(size=6) * 0.3
    phases, rates = rng.uniform(0, 6, k - 1), rng.uniform(0.5, 6, k - 1)
    values = []
    for step in range(round(seconds / dt)):
        W_tilde = last.W - W_star
        V = e @ P @ e
        if law.tracking_gain > 0.0:
            V += c / law.tracking_gain * float((W_tilde**2 / last.gamma[:, None]).sum())
        values.append(V)
        Phi = np.append(np.sin(rates * step * dt + phases), 1.0)
        last.step(Phi, e, W_star.T @ Phi, dt)
        e = e + dt * (A_rm @ e + B @ ((last.W - W_star).T @ Phi))
    return np.array(values)


@pytest.mark.parametrize(("bias_weight", "tracking_gain"), [(1.0, 50.0), (40.0, 50.0), (40.0, 500.0)])
def test_v_never_grows_on_a_plant_inside_the_feature_space(bias_weight, tracking_gain):
    law = config(bias_weight=bias_weight, tracking_gain=tracking_gain, weight_norm_max=1e3)
    _, Q, P = double_integrator()
    assert law.composite_gain >= composite_gain_needed(law, P[:, 3:], Q, 8)
    V = simulate_inside(law)
    # Explicit steps of e add terms of second order in dt.
    assert np.diff(V).max() <= 1e-6 * V[0]
    assert V[-1] < 0.9 * V[0]


def test_v_grows_with_the_printed_sign():
    V = simulate_inside(config(composite_gain=0.0, tracking_gain=500.0, weight_norm_max=1e3), sign=-1.0)
    assert np.diff(V).max() > 1e-6 * V[0]
    assert V[-1] > 2.0 * V.min()


def test_v_never_grows_for_the_bias_alone_without_composite():
    """m^2 is constant then, so that the cross term of the normalisation vanishes."""
    V = simulate_inside(config(composite_gain=0.0, tracking_gain=30.0, weight_norm_max=1e3), k=1)
    assert np.diff(V).max() <= 1e-5 * V[0]
    assert V[-1] < 0.7 * V[0]


def test_the_normalisation_condition_is_what_makes_the_form_definite():
    """-e'Qe + 2 (1 - c/m^2) e'PB n - 2 c lambda / (gamma m^2) |n|^2 <= 0 for all m^2, at and not below it."""
    low, high, gamma = 40.0, 60.0, 200.0
    Q, PB = np.diag([3.0, 0.1]), np.array([0.5, 0.2])
    c, rho = (low * high) ** 0.5, (high / low) ** 0.5
    needed = gamma * float(PB @ np.linalg.solve(Q, PB)) * (rho - 1.0) ** 2 / (2.0 * rho)

    def largest(composite_gain):
        worst = -np.inf
        for m2 in np.linspace(low, high, 101):
            form = np.zeros((3, 3))
            form[:2, :2] = -Q
            form[:2, 2] = form[2, :2] = (1.0 - c / m2) * PB
            form[2, 2] = -2.0 * c * composite_gain / (gamma * m2)
            worst = max(worst, float(np.linalg.eigvalsh(form)[-1]))
        return worst

    assert largest(needed) <= 1e-12
    assert largest(0.8 * needed) > 1e-6


def shipped_channels():
    for name in part_names("controllers"):
        for channel in ("position", "attitude"):
            tree = read_part("controllers", name)["settings"].get(channel, {})
            augmentation = tree.get("augmentation", {})
            law = augmentation.get("law", {})
            if law.get("kind") == "gradient" and law["composite_gain"] > 0.0:
                yield pytest.param(tree["gains"], augmentation, id=f"{name}-{channel}")


@pytest.mark.parametrize(("gains", "augmentation"), list(shipped_channels()))
def test_shipped_gains_satisfy_the_normalisation_condition(gains, augmentation):
    law = AdaptationConfig(**augmentation["law"])
    channel = ChannelGains(
        natural_frequency_rad_s=tuple(gains["natural_frequency_rad_s"]), damping=tuple(gains["damping"])
    )
    weights = augmentation.get("error_weight", (1.0, 0.1))
    Q = np.diag(np.repeat(np.array(weights, dtype=float), 3))
    P = lyapunov_p(channel.closed_loop_matrix(), Q)
    PB = tracking_weights(P, channel.natural_frequency_rad_s)
    k = {"bias": 1, "rbf": 21, "network": 21}[augmentation["features"]]
    for axis in range(3):
        scale = PB[axis, axis] / P[axis, 3 + axis]
        needed = composite_gain_needed(law, PB[:, [axis]], scale * Q, k)
        assert law.composite_gain >= needed, "the proof in docs/theory.md does not cover these gains: V may grow"


def test_the_tracking_weights_solve_the_lyapunov_equation_of_a_scaled_q():
    gains = ChannelGains(natural_frequency_rad_s=(16.0, 12.0, 5.0), damping=0.8)
    A_rm, Q = gains.closed_loop_matrix(), np.diag([1.0] * 3 + [0.01] * 3)
    P = lyapunov_p(A_rm, Q)
    PB = tracking_weights(P, gains.natural_frequency_rad_s)
    np.testing.assert_allclose(np.diag(PB[:3]), [1.0, (12 / 16) ** 3, (5 / 16) ** 3])
    scale = np.tile(np.diag(PB[:3]) / np.diag(P[:3, 3:]), 2)
    P_scaled = P * scale
    np.testing.assert_allclose(P_scaled, P_scaled.T)
    np.testing.assert_allclose(A_rm.T @ P_scaled + P_scaled @ A_rm, -Q * scale, atol=1e-12)
    np.testing.assert_allclose(P_scaled[:, 3:], PB)


def test_the_gain_does_not_depend_on_the_size_of_q():
    gains = ChannelGains(natural_frequency_rad_s=(4.0, 4.0, 5.0), damping=0.8)
    weights = [
        tracking_weights(lyapunov_p(gains.closed_loop_matrix(), size * np.eye(6)), gains.natural_frequency_rad_s)
        for size in (1e-3, 1.0, 1e3)
    ]
    np.testing.assert_allclose(weights[0], weights[1])
    np.testing.assert_allclose(weights[2], weights[1])


@pytest.mark.parametrize(("gains", "augmentation"), list(shipped_channels()))
def test_the_theorems_radius_contains_every_model_error_its_eps_can_cause(gains, augmentation):
    """The exact peak gain of e_dot = A_rm e + B delta, the integral of norm(exp(A_rm t) B), is below the radius's."""
    channel = ChannelGains(
        natural_frequency_rad_s=tuple(gains["natural_frequency_rad_s"]), damping=tuple(gains["damping"])
    )
    weights = augmentation.get("error_weight", (1.0, 0.1))
    A_rm = channel.closed_loop_matrix()
    P = lyapunov_p(A_rm, np.diag(np.repeat(np.array(weights, dtype=float), 3)))
    dt = 0.002
    step = scipy.linalg.expm(A_rm * dt)
    state, peak = np.vstack([np.zeros((3, 3)), np.eye(3)]), 0.0
    for _ in range(2500):
        peak += dt * float(np.linalg.norm(state, 2))
        state = step @ state
    assert peak < 2.0 * float(np.linalg.eigvalsh(P)[-1]) / min(weights)
