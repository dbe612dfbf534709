"""The bound of W's slope in flight: the nearest weights in the metric of S^-1, and an oscillation that it ends."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.control.features import BiasFeatures, NetworkFeatures, random_channel
from onboard.control.laws.kalman_last_layer import KalmanLastLayer
from onboard.control.laws.kalman_state import KalmanState
from onboard.control.laws.last_layer import lyapunov_p, tracking_weights
from onboard.control.laws.slope_bound import HERE, PERIOD_TICKS, SlopeBound, bound_slopes
from onboard.control.reference_model import ChannelGains
from onboard.control.slope import SlopeLimits, SlopeShares, largest_shares
from protocol.signals import SIGNAL_COUNT, SIGNAL_INDEX
from tests.onboard.control.laws.test_kalman_last_layer import config
from tests.onboard.control.laws.test_last_layer import SETTINGS

DT = 0.005
POSITION = ChannelGains(natural_frequency_rad_s=(3.2, 3.2, 5.0), damping=0.6)
ATTITUDE = ChannelGains(natural_frequency_rad_s=(11.0, 11.0, 5.0), damping=1.2)
NAMES = ("rate_p", "rate_q", "rate_r", "body_velocity_x", "body_velocity_y", "position_n", "motor_thrust_1")
GAINS = SlopeLimits.of("attitude", POSITION, ATTITUDE, SlopeShares(place=1.0, motion=1.0, turn=1.0))
TINY = SlopeLimits.of("attitude", POSITION, ATTITUDE, SlopeShares(place=1e-9, motion=1e-9, turn=1e-9))
K = 12


def random_state(seed, size=3.0):
    """A state with a covariance of large and small axes, J [K - 1, 3] and units [3, 3]."""
    rng = np.random.default_rng(seed)
    state = KalmanState(rng.normal(size=(K + 1, 3)), np.ones(K + 1), np.ones(K + 1))
    axes = np.linalg.qr(rng.normal(size=(K + 1, K + 1)))[0]
    S = axes @ np.diag(np.exp(-rng.uniform(0.0, 8.0, K + 1))) @ axes.T
    state.S[:] = 0.5 * (S + S.T)
    state.X_rows[:] = size * rng.normal(size=(3, K + 1))
    return state, rng.normal(size=(K - 1, 3)), rng.uniform(0.1, 3.0, (3, 3)), rng


def sizes(theta_rows, X_rows, J, units):
    """Slope of every axis, [3]."""
    return np.linalg.norm((theta_rows + X_rows)[:, :-2] @ J * units, axis=1)


# --- the projection --------------------------------------------------------------------------------------------------


@settings(max_examples=80, **SETTINGS)
@given(st.integers(0, 2**32 - 1), st.floats(0.01, 30.0))
def test_every_axis_is_within_its_share_and_at_the_nearest_point(seed, share):
    state, J, units, _ = random_state(seed)
    before, X, S = sizes(state.theta_rows, state.X_rows, J, units), state.X_rows.copy(), state.S.copy()
    bound_slopes(state, J, units / share)
    np.testing.assert_allclose(sizes(state.theta_rows, state.X_rows, J, units), np.minimum(before, share), rtol=1e-6)
    np.testing.assert_array_equal(state.S, S)
    np.testing.assert_array_equal(state.X_rows[before <= share], X[before <= share])
    for axis in np.flatnonzero(before > share):  # S^-1 (X - Y) is along the gradient of the slope's square at Y
        outward = np.linalg.solve(S, X[axis] - state.X_rows[axis])
        slope = J.T @ (state.theta_rows + state.X_rows)[axis, :-2]
        gradient = np.append(J @ (units[axis] ** 2 * slope), [0.0, 0.0])
        cosine = outward @ gradient / np.linalg.norm(outward) / np.linalg.norm(gradient)
        assert cosine == pytest.approx(1.0, abs=1e-5)


def flatter(rng, state, J, units, share):
    """[3, K + 1]: an X, random but for its slope, which is at most the share."""
    X_star = 2.0 * rng.normal(size=(3, K + 1))
    factor = np.minimum(1.0, share / sizes(state.theta_rows, X_star, J, units)) * rng.uniform(0.0, 1.0, 3)
    slope = (state.theta_rows + X_star)[:, :-2] @ J
    X_star[:, :-2] += (factor - 1.0)[:, None] * slope @ np.linalg.pinv(J)
    assert (sizes(state.theta_rows, X_star, J, units) <= share * (1.0 + 1e-9)).all()
    return X_star


@settings(max_examples=80, **SETTINGS)
@given(st.integers(0, 2**32 - 1), st.floats(0.05, 5.0))
def test_the_bound_never_adds_to_v_for_a_disturbance_that_keeps_it(seed, share):
    """tr(X~'S^-1 X~) falls at least by the square of the step: what the stability proof needs."""
    state, J, units, rng = random_state(seed)
    X, inverse = state.X_rows.copy(), np.linalg.inv(state.S)
    X_star = flatter(rng, state, J, units, share)
    bound_slopes(state, J, units / share)

    def V(error):
        return float((error @ inverse * error).sum())

    assert V(state.X_rows - X_star) <= V(X - X_star) - V(X - state.X_rows) + 1e-6 * V(X - X_star)


def test_scaling_the_weights_instead_adds_to_v():
    state, J, units, rng = random_state(1)
    X_star = flatter(rng, state, J, units, 0.1)
    state.X_rows[:] = X_star + 0.1 * rng.normal(size=(3, K + 1)) @ np.linalg.cholesky(state.S).T
    inverse = np.linalg.inv(state.S)

    def V(X_rows):
        return float(((X_rows - X_star) @ inverse * (X_rows - X_star)).sum())

    scaled, before = (state.theta_rows + state.X_rows) * 0.5 - state.theta_rows, V(state.X_rows)
    assert sizes(state.theta_rows, state.X_rows, J, units).max() > 0.5
    bound_slopes(state, J, units / 0.1)
    assert V(state.X_rows) <= before
    assert V(scaled) > 10.0 * before


def test_what_was_measured_well_hardly_changes():
    """After 2 s at one place the value there is known: the map is flattened about it."""
    rng = np.random.default_rng(4)
    features = NetworkFeatures(random_channel(NAMES, np.zeros(7), np.ones(7), (16, 9), rng))
    law = KalmanLastLayer(config(prior=3.0, fast_bias=0.1), 10, np.zeros((6, 3)), [(1.0, 1.0)] * 3)
    theta = 4.0 * rng.normal(size=(10, 3))
    law.replace(theta, theta)
    signals = rng.uniform(-0.5, 0.5, (SIGNAL_COUNT, 1)).repeat(3, axis=1)
    Phi = features.evaluate(features.select(signals))
    for _ in range(400):
        law.step(Phi, np.zeros(6), [1.0, -2.0, 3.0], DT)
    J, units, before = features.slope(HERE, np.array([0, 1, 2])), np.ones((3, 3)), law.estimate(Phi)[:, 0]
    share = 0.2 * sizes(law.state.theta_rows, law.state.X_rows, J, units).min()
    bound_slopes(law.state, J, units / share)
    np.testing.assert_allclose(sizes(law.state.theta_rows, law.state.X_rows, J, units), share, rtol=1e-6)
    moved = np.abs(law.estimate(Phi)[:, 0] - before)
    assert moved.max() < 0.1 * np.abs(before - theta.T @ Phi[:, 0]).max()


# --- inputs ----------------------------------------------------------------------------------------------------------


def steep(names):
    """Features of these inputs, the state of a law whose map is steep over all of them, and signals."""
    rng = np.random.default_rng(2)
    m = len(names)
    features = NetworkFeatures(random_channel(names, np.zeros(m), np.ones(m), (16, K - 1), rng))
    state = KalmanState(np.zeros((K + 1, 3)), np.ones(K + 1), np.ones(K + 1))
    state.X_rows[:] = 40.0 * rng.normal(size=(3, K + 1))
    signals = rng.uniform(-0.5, 0.5, (SIGNAL_COUNT, 2))
    features.evaluate(features.select(signals))
    return features, state, signals


@pytest.mark.parametrize("names", [NAMES, ("body_velocity_y",), ("motor_thrust_1", "rate_q", "position_n")])
def test_after_a_check_the_map_is_within_its_limit_over_every_kind(names):
    """By the limits of a swap, each of them a part of the norm over all inputs."""
    features, state, signals = steep(names)
    bound = SlopeBound(features.inputs, GAINS)
    before = state.X_rows.copy()
    for tick in range(PERIOD_TICKS + 1):
        if tick in (0, PERIOD_TICKS):
            state.X_rows[:] = before
        unchanged = state.X_rows.copy()
        bound.step(features, state)
        assert np.array_equal(state.X_rows, unchanged) is (tick % PERIOD_TICKS != 0)
    assert largest_shares(features.channel, before[:, :-1].T, GAINS, signals[:, :1]).max() > 1.5
    shares = largest_shares(features.channel, state.X_rows[:, :-1].T, GAINS, signals[:, :1])
    assert 0.3 < shares.max() < 1.0 + 1e-6


def test_inputs_that_are_in_no_loop_are_left_alone():
    features, state, _ = steep(("motor_thrust_1", "battery_voltage"))
    before = state.X_rows.copy()
    SlopeBound(features.inputs, TINY).step(features, state)
    SlopeBound(BiasFeatures.inputs, TINY).step(BiasFeatures(), state)
    np.testing.assert_array_equal(state.X_rows, before)


# --- in a loop -------------------------------------------------------------------------------------------------------


def swing_after_a_push(share, prior, seed):
    """RMS rate, rad/s, 2 to 4 s after a push of 3 s at 2 Hz has ended, of an attitude loop with 15 ms of unknown delay.

    The loop has motors of 40 ms and 10 ms of known delay, untrained features of the rates, and the law's shipped gains.
    """
    rng, names = np.random.default_rng(seed), ("rate_p", "rate_q", "rate_r")
    features = NetworkFeatures(random_channel(names, np.zeros(3), np.full(3, 2.0), (32, 32, 19), rng))
    gains = ChannelGains(natural_frequency_rad_s=(11.38, 11.38, 5.0), damping=1.17)
    settings_of_law = {
        "tracking_gain": 93.54, "composite_gain": 6.384, "noise": 9.937, "prior": prior, "fast_bias": 19.8,
        "prior_rate": 0.02475, "fast_bias_rate": 0.2834, "weight_norm_max": 250.0,
    }  # fmt: skip
    P = lyapunov_p(gains.closed_loop_matrix(), np.diag([1.0] * 3 + [0.01] * 3))
    law = KalmanLastLayer(
        config(**settings_of_law), 20, tracking_weights(P, gains.natural_frequency_rad_s), gains.pairs()
    )
    limits = SlopeLimits.of("attitude", POSITION, gains, SlopeShares(place=1.0, motion=1.0, turn=share))
    bound = SlopeBound(names, limits)
    k1, k2 = gains.stiffness(), gains.rate_gain()
    angle, rate, before = np.zeros(3), np.array([1.0, 0.5, 0.2]), np.array([1.0, 0.5, 0.2])
    demands, delivered, believed = [np.zeros(3)] * 6, np.zeros(3), np.zeros(3)
    signals, rates = np.zeros((SIGNAL_COUNT, 3)), []
    rows = [SIGNAL_INDEX[name] for name in names]
    for tick in range(1400):
        signals[rows] = rate[:, None]
        Phi = features.evaluate(features.select(signals))
        residual = (rate - before) / DT - believed + 3.0 * rng.normal(size=3)
        bound.step(features, law.state)
        nu = law.step(Phi, np.zeros(6), residual.tolist(), DT)[:, 1]
        demands.append(-k1 * angle - k2 * rate - nu)
        delivered = delivered + DT / 0.04 * (demands[-6] - delivered)
        believed = believed + DT / 0.04 * (demands[-3] - believed)
        push = 30.0 * np.sin(4.0 * np.pi * tick * DT + np.arange(3)) if tick < 600 else 0.0
        before = rate
        rate = rate + DT * (delivered + push)
        angle = angle + DT * rate
        rates.append(rate)
    return float(np.sqrt(np.square(rates[1000:]).sum(axis=1).mean()))


@pytest.mark.parametrize("seed", [2, 3])
def test_untrained_features_do_not_answer_an_oscillation_with_one_of_their_own(seed):
    """With a large prior they learn the delay as a slope over the rates, and the loop swings on; not so bounded."""
    free = swing_after_a_push(1e6, 3.2, seed)
    assert free > 2.0
    assert swing_after_a_push(0.1, 3.2, seed) < 0.4 * free
    assert swing_after_a_push(1e6, 0.1, seed) < 0.2 * free
