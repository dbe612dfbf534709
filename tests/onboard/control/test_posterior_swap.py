"""The swap of the law with a covariance: the posterior on the recent states, no jump here, what is refused."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.control.feature_swap import RecentStates, SwapConfig
from onboard.control.features import NetworkFeatures
from onboard.control.laws.adaptive import AdaptiveAugmentation, AdaptiveConfig
from onboard.control.laws.kalman_last_layer import prior_variance
from onboard.control.laws.law import ChannelState
from onboard.control.posterior_swap import FOLLOWED_MAX, PosteriorSwap
from onboard.control.records import ChannelTelemetry
from onboard.control.reference_model import ChannelGains
from onboard.control.slope import SlopeLimits, SlopeShares
from protocol.feature_config import SignalScale, UntrainedFeatures
from protocol.signals import SIGNAL_COUNT
from tests.onboard.control.laws.test_kalman_last_layer import config, law
from tests.onboard.control.test_feature_swap import INPUTS, ROWS, channel

DT = 0.005
GAINS = ChannelGains(natural_frequency_rad_s=(4.0, 4.0, 5.0), damping=0.8)


def flying(swap_config, seconds=2.0, **over):
    """An augmentation that has adapted along a path, its channel, and nu at the last tick."""
    settings_ = AdaptiveConfig(kind="adaptive", features="network", law=config(**over), swap=swap_config)
    scales = {name: SignalScale(offset=0.0, scale=1.0) for name in INPUTS}
    inputs = UntrainedFeatures(position_inputs=INPUTS, attitude_inputs=INPUTS, hidden=(16,), count=10, scales=scales)
    augmentation = AdaptiveAugmentation(
        settings_,
        GAINS,
        inputs,
        "position",
        np.random.default_rng(0),
        SlopeLimits.of("position", GAINS, GAINS, SlopeShares(place=1.0, motion=1.0, turn=1.0)),
    )
    state = ChannelState(dt=DT, adapt=True, signals=np.zeros((SIGNAL_COUNT, 3)))
    rng = np.random.default_rng(1)
    for tick in range(round(seconds / DT)):
        for column, t in enumerate((tick * DT, tick * DT + 0.17)):
            state.signals[ROWS, column] = np.sin(t), np.sin(2 * t), np.cos(t)
        state.residual[:] = 2.0 * state.signals[ROWS, 0] + 0.3 * rng.normal(size=3)
        nu = augmentation.step(state, ChannelTelemetry())
    return augmentation, state, nu.copy()


@settings(max_examples=30, deadline=None, derandomize=True)
@given(st.integers(1, 40), st.integers(0, 2**32 - 1), st.floats(0.05, 10.0), st.floats(0.1, 5.0))
def test_the_posterior_solves_for_all_recent_states_at_once(n, seed, fast_bias_rate, fast_bias):
    """W of the prior and b an Ornstein-Uhlenbeck process: X and S follow from the joint covariance of y and [W; b]."""
    one = law(10, fast_bias_rate=fast_bias_rate, fast_bias=fast_bias, noise=0.4)
    prior, since, source = prior_variance(one.config, 10), 0.01, channel(seed % 1000)
    swap, ring = prepared(one, source, n, seed)
    plan = swap.plan(swap.new, np.zeros((SIGNAL_COUNT, 3)), since)
    signals, y = ring.in_order()
    Phi = swap.new.evaluate(swap.new.select(signals))
    age = BETWEEN * np.arange(n - 1, -1, -1) + since
    weighted = prior[:-1, None] * Phi
    C = Phi.T @ weighted + prior[-1] * np.exp(-fast_bias_rate * np.abs(age[:, None] - age))
    C.flat[:: n + 1] += one.residual_variance(DT)
    M = np.vstack([weighted, prior[-1] * np.exp(-fast_bias_rate * age)])
    X = M @ np.linalg.solve(C, y - Phi.T @ swap.theta)
    S = np.diag(prior) - M @ np.linalg.solve(C, M.T)
    np.testing.assert_allclose(plan.X[:-1], X[:-1], rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(plan.S, S, rtol=1e-6, atol=1e-8)
    np.testing.assert_array_equal(plan.S, plan.S.T)
    assert np.linalg.eigvalsh(plan.S)[0] > 0.0


BETWEEN = 0.025


def prepared(one, source, n, seed):
    """A swap whose parts are done, on a ring of n states, and the ring."""
    rng, ring = np.random.default_rng(seed), RecentStates(40, SIGNAL_COUNT)
    for _ in range(n):
        ring.push(rng.normal(size=SIGNAL_COUNT), rng.normal(size=3))
    limits = SlopeLimits.of("position", GAINS, GAINS, SlopeShares(place=1.0, motion=1.0, turn=1.0))
    now, times = np.zeros((SIGNAL_COUNT, 3)), (DT, BETWEEN)
    swap = PosteriorSwap(SwapConfig(jump_max=1e9), one, NetworkFeatures(source), limits, ring, now, times)
    while not swap.step():
        pass
    return swap, ring


def test_without_a_past_the_prior_is_taken():
    one = law(10)
    swap, _ = prepared(one, channel(3), 0, 1)
    plan = swap.plan(swap.new, np.zeros((SIGNAL_COUNT, 3)), 0.0)
    np.testing.assert_array_equal(plan.X[:-1], 0.0)
    np.testing.assert_array_equal(plan.S, np.diag(prior_variance(one.config, 10)))


def test_states_that_come_while_the_parts_are_done_are_taken_too():
    """X and S are those of a preparation that begins later, on a ring that holds all of these states."""
    rng, source, one = np.random.default_rng(5), channel(5, memory=0.1 * channel(5).last_layer), law(10)
    states = [(rng.normal(size=SIGNAL_COUNT), rng.normal(size=3)) for _ in range(12)]
    limits = SlopeLimits.of("position", GAINS, GAINS, SlopeShares(place=1e3, motion=1e3, turn=1e3))
    now, plans = np.zeros((SIGNAL_COUNT, 3)), []
    for before in (12, 7):
        ring = RecentStates(40, SIGNAL_COUNT)
        for state in states[:before]:
            ring.push(*state)
        new = NetworkFeatures(source)
        swap = PosteriorSwap(SwapConfig(jump_max=1e9), one, new, limits, ring, now, (DT, BETWEEN))
        coming, over = list(states[before:]), False
        while not over or coming:
            if coming:
                ring.push(*coming.pop(0))
            swap.follow()
            over = over or swap.step()
        assert swap.seen == 12
        assert swap.measured[0].shape[1] <= 12
        plans.append(swap.plan(new, now, 0.01))
    np.testing.assert_allclose(plans[1].X, plans[0].X, atol=1e-9)
    np.testing.assert_allclose(plans[1].S, plans[0].S, atol=1e-9)


def test_states_beyond_the_room_for_them_are_left_to_the_law():
    swap, ring = prepared(law(10), channel(5, memory=0.1 * channel(5).last_layer), 3, 1)
    for _ in range(FOLLOWED_MAX + 9):
        ring.push(np.ones(SIGNAL_COUNT))
        swap.follow()
    assert swap.seen == 3 + FOLLOWED_MAX
    assert swap.plan(swap.new, np.zeros((SIGNAL_COUNT, 3)), 9 * BETWEEN).refusal == ""


@pytest.mark.parametrize("seed", range(8))
def test_nu_does_not_jump_where_the_vehicle_is_nor_by_more_than_reported_ahead(seed):
    augmentation, state, before = flying(SwapConfig(jump_max=1e9))
    telemetry = ChannelTelemetry()
    state.adapt = False
    augmentation.step(state, telemetry)
    here = telemetry.adaptive_now.copy()
    features, plan = augmentation.plan(channel(77 + seed))
    assert plan.refusal == ""
    augmentation.commit(features, plan)
    after = augmentation.step(state, telemetry)
    np.testing.assert_allclose(telemetry.adaptive_now, here, atol=1e-9)
    assert np.linalg.norm(after - before) <= plan.jump + 1e-9
    assert telemetry.eps_2 == plan.jump
    np.testing.assert_allclose(augmentation.last_layer.W, plan.W, atol=1e-12)


def test_a_naive_swap_jumps_where_the_vehicle_is():
    augmentation, state, _ = flying(SwapConfig(jump_max=1e9, naive=True))
    telemetry = ChannelTelemetry()
    state.adapt = False
    augmentation.step(state, telemetry)
    here = telemetry.adaptive_now.copy()
    augmentation.commit(*augmentation.plan(channel(77)))
    augmentation.step(state, telemetry)
    assert np.linalg.norm(telemetry.adaptive_now - here) > 0.5


def test_a_map_that_was_right_is_kept_and_a_wrong_one_is_corrected_at_once():
    """theta that explains the recent residuals stays; one that does not is moved there before it flies."""
    augmentation, _, _ = flying(SwapConfig(jump_max=1e9))
    source = channel(5)
    new = NetworkFeatures(source)
    signals, y = augmentation._recent.in_order()
    Phi = new.evaluate(new.select(signals))
    right = np.linalg.solve(Phi @ Phi.T + 1e-3 * np.eye(10), Phi @ y)
    _, of_right = augmentation.plan(dataclasses.replace(source, last_layer=right))
    _, of_wrong = augmentation.plan(dataclasses.replace(source, last_layer=right + 1.0))
    assert np.abs(of_right.W - right).max() < 0.2
    misfit = np.abs((of_wrong.W - right).T @ Phi + of_wrong.X[-1][:, None])
    assert np.median(misfit[:, -20:]) < 0.35 * np.median(np.abs(np.ones((3, 10)) @ Phi))


def test_a_law_that_is_off_flies_the_trained_map():
    augmentation, state, _ = flying(SwapConfig(jump_max=1e9), composite_gain=0.0, tracking_gain=0.0)
    source = channel(9)
    augmentation.commit(*augmentation.plan(source))
    Phi = augmentation.features.evaluate(augmentation.features.select(state.signals))
    nu = augmentation.step(state, ChannelTelemetry())
    np.testing.assert_allclose(nu, source.last_layer.T @ Phi[:, 1], atol=1e-12)


@pytest.mark.parametrize(
    ("source", "swap_config", "reason"),
    [
        (channel(1, gain=30.0), SwapConfig(jump_max=1e9), "lipschitz"),
        (channel(1, memory=np.full((10, 3), 20.0)), SwapConfig(jump_max=1e9), "weight_norm"),
        (channel(1), SwapConfig(jump_max=1e-9), "swap_jump"),
    ],
)
def test_refusals_before_anything_changes(source, swap_config, reason):
    augmentation, _, _ = flying(swap_config)
    X, S = augmentation.last_layer.state.X_rows.copy(), augmentation.last_layer.state.S.copy()
    _, plan = augmentation.plan(source)
    assert plan.refusal == reason
    np.testing.assert_array_equal(augmentation.last_layer.state.X_rows, X)
    np.testing.assert_array_equal(augmentation.last_layer.state.S, S)


def test_numbers_that_are_not_finite_are_refused():
    augmentation, _, _ = flying(SwapConfig(jump_max=1e9))
    augmentation._recent.push(np.full(SIGNAL_COUNT, np.nan))
    assert augmentation.plan(channel(3))[1].refusal == "not_finite"


def test_the_ring_is_in_order():
    ring = RecentStates(4, SIGNAL_COUNT)
    for value in range(6):
        ring.push(np.full(SIGNAL_COUNT, float(value)), (float(value), 0.0, 1.0))
    signals, residuals = ring.in_order()
    assert signals[0].tolist() == [2.0, 3.0, 4.0, 5.0]
    assert residuals[:, 0].tolist() == [2.0, 3.0, 4.0, 5.0]
