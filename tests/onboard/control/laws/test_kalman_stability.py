"""Stability of the law with a covariance: its Lyapunov inequality step by step, and wing rock (docs/theory.md)."""

import numpy as np
import pytest

from onboard.control.laws.kalman_last_layer import KalmanLastLayer, prior_variance
from onboard.control.laws.last_layer import lyapunov_p, tracking_weights
from onboard.control.reference_model import ChannelGains
from tests.onboard.control.laws.test_kalman_last_layer import config
from tests.onboard.control.laws.test_last_layer import double_integrator, fly_wing_rock, rms, wing_rock_delta

STEP = 5e-4
NOISE_INTENSITY = 0.05
"""R dt, (m/s^2)^2 s: what stays the same when the tick gets shorter."""


class Plant:
    """e_dot = A_rm e + B (nu - Delta) with Delta = W*'Phi + b*, W* and b* drifting; e, W and b far off at the start."""

    def __init__(self, drift=0.0, k=8, **over):
        rng = np.random.default_rng(3)
        self.A_rm, self.Q, self.P = double_integrator()
        self.B = np.vstack([np.zeros((3, 3)), np.eye(3)])
        values = {"noise": (NOISE_INTENSITY / STEP) ** 0.5, "composite_gain": 1e3, "tracking_gain": 5e3} | over
        self.law = KalmanLastLayer(config(weight_norm_max=1e3, **values), k, self.P @ self.B, [(16.0, 6.4)] * 3)
        self.theta, self.X_star = rng.normal(size=(k, 3)), rng.normal(size=(k + 1, 3))
        self.law.replace(self.theta, self.theta)
        self.X_drift = drift * rng.normal(size=(k + 1, 3))
        self.e, self.k = rng.normal(size=6) * 0.3, k
        self.phases, self.rates = rng.uniform(0, 6, k - 1), rng.uniform(0.5, 6, k - 1)
        self.t = self.law.config.tracking_gain / self.law.config.composite_gain
        self.time = 0.0

    def star(self):
        """[W* - theta; b*] and its rate at the present."""
        turn = np.sin(0.7 * self.time), 0.7 * np.cos(0.7 * self.time)
        return self.X_star + turn[0] * self.X_drift, turn[1] * self.X_drift

    def noise_intensity(self):
        """R_t dt of the present step, as the law chooses it."""
        phi = np.append(self.Phi(), 1.0)
        s = float(phi @ self.law.state.S @ phi)
        return max(self.law.config.noise**2, s / (self.law.config.composite_gain * STEP)) * STEP

    def Phi(self):
        return np.append(np.sin(self.rates * self.time + self.phases), 1.0)

    def V(self):
        """e'P e + (R dt / t) tr(X~'S^-1 X~)."""
        error = self.law.state.X_rows.T - self.star()[0]
        return float(self.e @ self.P @ self.e) + self.noise_intensity() / self.t * float(
            (error * np.linalg.solve(self.law.state.S, error)).sum()
        )

    def forcing(self):
        """(R dt / t) tr(f'(D S0)^-1 f), f = D X* + X*_dot."""
        X_star, X_star_dot = self.star()
        rates = np.append(np.full(self.k, self.law.config.prior_rate), self.law.config.fast_bias_rate)
        f = rates[:, None] * X_star + X_star_dot
        weight = rates * prior_variance(self.law.config, self.k)
        return self.noise_intensity() / self.t * float((f * f / weight[:, None]).sum())

    def kappa(self):
        slowest = min(self.law.config.prior_rate, self.law.config.fast_bias_rate)
        return min(float(self.Q.diagonal().min() / np.linalg.eigvalsh(self.P)[-1]), slowest)

    def step(self):
        Phi, X_star = self.Phi(), self.star()[0]
        Delta = (self.theta + X_star[:-1]).T @ Phi + X_star[-1]
        nu = self.law.step(np.stack([Phi, Phi, Phi], axis=1), self.e, Delta.tolist(), STEP)[:, 0]
        self.e = self.e + STEP * (self.A_rm @ self.e + self.B @ (nu - Delta))
        self.time += STEP


@pytest.mark.parametrize("drift", [0.0, 0.5, 3.0])
@pytest.mark.parametrize("tracking_gain", [300.0, 1e4])
def test_v_obeys_its_inequality_on_a_linear_plant_with_a_drifting_delta(drift, tracking_gain):
    """V_dot <= -kappa V + forcing, with nothing asked of the excitation or of the tracking gain."""
    plant = Plant(drift, tracking_gain=tracking_gain)
    value = start = plant.V()
    for _ in range(3000):
        allowed = value + STEP * (plant.forcing() - plant.kappa() * value)
        plant.step()
        value = plant.V()
        assert value <= allowed + 2e-5 * start  # explicit steps of e add terms of second order
    assert drift > 0.0 or value < 0.7 * start


def test_v_falls_to_nothing_if_the_prior_is_right():
    plant = Plant(tracking_gain=1e4)
    plant.X_star[:] = 0.0
    plant.law.state.X_rows[:] = np.random.default_rng(4).normal(size=(3, 9))
    V = [plant.V()]
    for _ in range(4000):
        plant.step()
        V.append(plant.V())
    assert np.diff(V).max() <= 1e-6 * V[0]
    assert V[-1] < 0.4 * V[0]


def test_the_opposite_sign_of_the_tracking_term_breaks_the_inequality():
    plant = Plant(tracking_gain=1e4)
    plant.law._PB = -30.0 * plant.law._PB
    V = [plant.V()]
    for _ in range(1000):
        plant.step()
        V.append(plant.V())
    assert np.diff(V).max() > 1e-4 * V[0]


def test_while_the_limit_binds_v_grows_at_most_as_r_t_does():
    """R_t weighs the part of X in V: where the features turn to what is less known, R_t rises, and V with it."""
    plant = Plant(composite_gain=15.0, tracking_gain=150.0, noise=0.1)
    value, R = plant.V(), plant.noise_intensity()
    start, bound = value, 0
    for _ in range(3000):
        allowed, before = value + STEP * plant.forcing(), R
        plant.step()
        value, R = plant.V(), plant.noise_intensity()
        bound += 1.001 * plant.law.config.noise**2 * STEP < R
        assert value <= allowed * max(1.0, R / before) + 2e-5 * start
    assert bound > 500
    assert value < 0.5 * start


def wing_rock(law_config, seconds=40.0, drift=0.0):
    """Errors e [n, 2] of the roll against a square wave's reference; the coefficients drift by the share `drift`."""
    k1, k2, dt = 1.0, 1.0, 0.005
    A_rm = np.array([[0.0, 1.0], [-k1, -k2]])
    PB = np.zeros((2, 3))
    PB[:, 0] = lyapunov_p(A_rm, np.eye(2))[:, 1]
    last = KalmanLastLayer(law_config, 10, PB, [(k1, k2)] * 3)
    centres = np.array([(a, b) for a in (-1.0, 0.0, 1.0) for b in (-1.0, 0.0, 1.0)])
    x, x_rm, errors = np.zeros(2), np.zeros(2), []
    for step in range(round(seconds / dt)):
        r = 0.5 if (step * dt) % 20.0 < 10.0 else -0.5
        errors.append(x_rm - x)
        Phi = np.append(np.exp(-((x - centres) ** 2).sum(axis=1)), 1.0)
        delta = wing_rock_delta(*x) * (1.0 + drift * np.sin(0.9 * step * dt))
        nu = last.step(np.stack([Phi, Phi, Phi], axis=1), errors[-1], [delta, 0.0, 0.0], dt)[0, 0]
        u = k1 * (r - x[0]) - k2 * x[1] - nu
        x = x + dt * np.array([x[1], u + delta])
        x_rm = x_rm + dt * (A_rm @ x_rm + np.array([0.0, k1 * r]))
    return np.array(errors)


@pytest.mark.parametrize("drift", [0.0, 0.6])
def test_wing_rock_is_followed_with_constant_and_with_drifting_coefficients(drift):
    law_config = config(tracking_gain=20.0, composite_gain=10.0, prior=1.0, noise=0.3)
    late = wing_rock(law_config, drift=drift)[4000:]
    none = fly_wing_rock(+1, adapt=False)[4000:]
    assert rms(late) < 0.02 * rms(none), (rms(late), rms(none))


def test_the_tracking_term_helps_on_wing_rock_where_the_residual_is_not_believed():
    doubtful = {"composite_gain": 10.0, "prior": 1.0, "noise": 30.0, "fast_bias": 1.0}
    without = rms(wing_rock(config(tracking_gain=0.0, **doubtful))[4000:])
    assert rms(wing_rock(config(tracking_gain=200.0, **doubtful))[4000:]) < 0.5 * without


def test_the_shipped_poles_make_kappa_the_rate_of_the_prior():
    """The loop is faster than the mean reversion, so that the slower of its rates bounds the convergence of V."""
    gains = ChannelGains(natural_frequency_rad_s=(5.6, 5.6, 5.0), damping=0.7)
    Q = np.diag([1.0] * 3 + [0.1] * 3)
    P = lyapunov_p(gains.closed_loop_matrix(), Q)
    assert tracking_weights(P, gains.natural_frequency_rad_s).shape == (6, 3)
    assert Q.min(initial=1.0, where=Q > 0) / np.linalg.eigvalsh(P)[-1] > 0.03
