"""The bumpless swap: nu_ad does not jump where the vehicle is, W_bar elsewhere, refusal before anything changes."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.control.feature_swap import RecentStates, SwapConfig, bumpless_last_layer, plan_swap, resemblance
from onboard.control.features import NetworkFeatures, random_channel
from onboard.control.laws.adaptive import AdaptiveAugmentation, AdaptiveConfig
from onboard.control.laws.last_layer import PROJECTION_MARGIN, AdaptationConfig
from onboard.control.laws.law import ChannelState
from onboard.control.records import ChannelTelemetry
from onboard.control.reference_model import ChannelGains
from onboard.control.slope import SlopeLimits, SlopeShares
from protocol.feature_config import SignalScale, UntrainedFeatures
from protocol.feature_set import ChannelFeatures
from protocol.signals import SIGNAL_COUNT, SIGNAL_INDEX

INPUTS = ("position_n", "position_e", "velocity_n")
ROWS = [SIGNAL_INDEX[name] for name in INPUTS]
CONFIG = SwapConfig(jump_max=1.0)
NAIVE = SwapConfig(jump_max=1.0, naive=True)
RADIUS = 40.0


def channel(seed, gain=1.0, memory=None):
    rng = np.random.default_rng(seed)
    start = random_channel(INPUTS, np.zeros(3), np.ones(3), (16, 9), rng)
    last_layer = rng.normal(size=(10, 3)) if memory is None else memory
    return ChannelFeatures(
        INPUTS, start.offset, start.scale, tuple(gain * W for W in start.weights), start.biases, last_layer
    )


def states(seed, n=42, spread=0.1):
    """[SIGNAL_COUNT, n] along a short stretch of a path."""
    rng = np.random.default_rng(seed)
    recent = np.zeros((SIGNAL_COUNT, n))
    start, direction = rng.uniform(-1, 1, 3), rng.normal(size=3)
    recent[ROWS] = start[:, None] + np.outer(direction, np.linspace(0, spread, n)) + rng.normal(size=(3, n)) * 0.01
    return recent


def swap(config, seed, recent, refined=None):
    """From random features with a random W to random ones, or to the same ones with biases changed by `refined`."""
    old, new = channel(seed), channel(seed + 1000)
    if refined is not None:
        biases = tuple(b + refined for b in old.biases)
        new = dataclasses.replace(old, biases=biases, last_layer=new.last_layer)
    W = np.random.default_rng(seed + 2000).normal(size=(10, 3))
    features = NetworkFeatures(old), NetworkFeatures(new)
    return features, W, plan_swap(config, features[0], W, features[1], new.last_layer, RADIUS, recent)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.integers(0, 10**6), st.sampled_from([None, 0.02, 0.1, 0.3]))
def test_the_jump_stays_below_the_bound_that_follows_from_the_fit(seed, refined):
    """W_new minimises fit + mu norm^2, so the squared jumps add up to no more than W = W_bar leaves."""
    recent = states(seed)
    (old, new), W, plan = swap(CONFIG, seed, recent, refined)
    memory = channel(seed + 1000).last_layer
    Phi, Phi_bar = old.evaluate(old.select(recent)), new.evaluate(new.select(recent))
    share = resemblance(Phi, Phi_bar)
    assert refined is None or refined > 0.1 or share > 0.3
    W_bar = memory + share * (W - memory)
    misfit = W_bar.T @ Phi_bar - W.T @ Phi
    assert plan.jump <= np.sqrt((misfit**2).sum()) + 1e-9
    change = plan.W.T @ Phi_bar - W.T @ Phi
    assert plan.jump == pytest.approx(np.linalg.norm(change, axis=0).max())


def test_bumpless_where_the_naive_swap_jumps():
    """Over many pairs of features: ours stays below the bound, the naive swap jumps by several times the bound."""
    ours, naive = [], []
    for seed in range(30):
        recent = states(seed)
        ours.append(swap(CONFIG, seed, recent)[2])
        naive.append(swap(NAIVE, seed, recent)[2])
    assert max(plan.jump for plan in ours) < CONFIG.jump_max
    assert not any(plan.refusal for plan in ours)
    assert np.median([plan.jump for plan in naive]) > 2.0 * CONFIG.jump_max
    assert sum(plan.refusal == "swap_jump" for plan in naive) > 20


def test_between_the_recent_states_the_lipschitz_constants_bound_the_jump():
    recent = states(3)
    (old, new), W, plan = swap(CONFIG, 3, recent)
    between = 0.5 * (recent[:, :-1] + recent[:, 1:])
    step = np.linalg.norm(np.diff(recent[ROWS], axis=1), axis=0).max() / 2
    change = plan.W.T @ new.evaluate(new.select(between)) - W.T @ old.evaluate(old.select(between))
    bound = plan.jump + step * (np.linalg.norm(plan.W, 2) * new.lipschitz + np.linalg.norm(W, 2) * old.lipschitz)
    assert np.linalg.norm(change, axis=0).max() <= bound


def test_what_the_recent_states_do_not_tell_is_w_bar():
    """Where the features differ from those of the recent states, W_new' Phi is W_bar' Phi."""
    rng = np.random.default_rng(0)
    Phi_bar = np.zeros((6, 20))
    Phi_bar[:3] = rng.normal(size=(3, 20))
    W_bar = rng.normal(size=(6, 3))
    W = bumpless_last_layer(Phi_bar, rng.normal(size=(3, 20)), W_bar, 1e-3)
    np.testing.assert_allclose(W[3:], W_bar[3:], atol=1e-12)


def test_the_same_features_keep_the_last_layer_whatever_was_trained_with_them():
    recent = states(4)
    features = NetworkFeatures(channel(4))
    W, memory = np.random.default_rng(4).normal(size=(2, 10, 3))
    plan = plan_swap(CONFIG, features, W, features, memory, RADIUS, recent)
    np.testing.assert_allclose(plan.W, W, atol=1e-10)
    assert plan.jump < 1e-9


def test_features_learnt_afresh_come_with_their_memory():
    """The further the new features are from the old ones, the less of W goes into what the recent states leave open."""
    recent = states(7)
    start = channel(7)
    W, memory = np.random.default_rng(7).normal(size=(2, 10, 3))
    old = NetworkFeatures(start)
    nearly_w_bar = SwapConfig(jump_max=1e9, memory_weight=1e6)
    far = []
    for change in (0.0, 0.03, 0.3, 3.0):
        new = NetworkFeatures(dataclasses.replace(start, biases=tuple(b + change for b in start.biases)))
        Phi_bar = new.evaluate(new.select(recent))
        share = resemblance(old.evaluate(old.select(recent)), Phi_bar)
        plan = plan_swap(nearly_w_bar, old, W, new, memory, RADIUS, recent)
        np.testing.assert_allclose(plan.W, memory + share * (W - memory), atol=1e-3)
        far.append(share)
    assert far[0] == 1.0
    assert far == sorted(far, reverse=True)
    assert far[-1] == 0.0


@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.integers(0, 10**6), st.floats(0.0, 10.0))
def test_resemblance_is_a_share_and_ignores_the_bias(seed, change):
    rng = np.random.default_rng(seed)
    Phi, step = rng.normal(size=(2, 6, 20))
    Phi[-1] = step[-1] = 1e3
    share = resemblance(Phi, Phi + change * step)
    assert 0.0 <= share <= 1.0
    assert share == pytest.approx(max(0.0, 1.0 - change * np.linalg.norm(step[:-1]) / np.linalg.norm(Phi[:-1])))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_features_that_are_not_finite_resemble_nothing(bad):
    Phi = np.ones((6, 20))
    assert resemblance(np.zeros((6, 20)), Phi) == 0.0
    assert resemblance(Phi, np.full((6, 20), bad)) == 0.0


def test_the_last_layer_is_the_minimiser():
    rng = np.random.default_rng(1)
    Phi_bar, nu, memory, mu = rng.normal(size=(6, 20)), rng.normal(size=(3, 20)), rng.normal(size=(6, 3)), 0.7
    W = bumpless_last_layer(Phi_bar, nu, memory, mu)

    def cost(candidate):
        return ((candidate.T @ Phi_bar - nu) ** 2).sum() + mu * ((candidate - memory) ** 2).sum()

    for _ in range(20):
        assert cost(W) <= cost(W + 1e-3 * rng.normal(size=W.shape))


def test_if_memory_agrees_with_what_flies_it_is_taken_whole():
    recent = states(5)
    source = channel(5)
    features = NetworkFeatures(source)
    plan = plan_swap(CONFIG, features, source.last_layer, features, source.last_layer, RADIUS, recent)
    np.testing.assert_allclose(plan.W, source.last_layer, atol=1e-10)
    assert plan.jump < 1e-9


def test_without_a_past_the_memory_is_taken():
    _, _, plan = swap(CONFIG, 6, np.zeros((SIGNAL_COUNT, 0)))
    np.testing.assert_array_equal(plan.W, channel(1006).last_layer)
    assert (plan.jump, plan.refusal) == (0.0, "")


@pytest.mark.parametrize("gain", [1.0, 30.0])
def test_what_is_too_large_is_refused_without_a_past_as_well(gain):
    source = channel(1, gain=gain, memory=np.full((10, 3), 20.0))
    features = NetworkFeatures(source)
    empty = np.zeros((SIGNAL_COUNT, 0))
    plan = plan_swap(CONFIG, features, source.last_layer, features, source.last_layer, RADIUS, empty)
    assert plan.refusal == ("weight_norm" if gain == 1.0 else "lipschitz")


@pytest.mark.parametrize(
    ("source", "config", "reason"),
    [
        (channel(1, gain=30.0), CONFIG, "lipschitz"),
        (channel(1, memory=np.full((10, 3), 20.0)), CONFIG, "weight_norm"),
        (channel(1), SwapConfig(jump_max=1e-9), "swap_jump"),
    ],
)
def test_refusals(source, config, reason):
    old = NetworkFeatures(channel(2))
    W = np.random.default_rng(3).normal(size=(10, 3))
    before = W.copy()
    plan = plan_swap(config, old, W, NetworkFeatures(source), source.last_layer, RADIUS, states(4))
    assert plan.refusal == reason
    np.testing.assert_array_equal(W, before)


def test_a_last_layer_beyond_the_ball_is_refused():
    """The fit may need a larger W than the ball holds: what would be clipped would jump."""
    old, new = NetworkFeatures(channel(2)), channel(3, memory=np.zeros((10, 3)))
    W = np.full((10, 3), 30.0)
    plan = plan_swap(
        SwapConfig(jump_max=1e9, memory_weight=1e-6), old, W, NetworkFeatures(new), new.last_layer, 1.0, states(4)
    )
    assert plan.refusal == "weight_norm"
    assert np.linalg.norm(plan.W) > (1.0 + PROJECTION_MARGIN) ** 0.5


def test_numbers_that_are_not_finite_are_refused():
    recent = states(4)
    recent[ROWS[0], 3] = np.nan
    _, _, plan = swap(CONFIG, 7, recent)
    assert plan.refusal == "not_finite"


def test_more_features_than_before_can_be_swapped_in():
    old, rng = NetworkFeatures(channel(8)), np.random.default_rng(9)
    wide = dataclasses.replace(
        random_channel(INPUTS, np.zeros(3), np.ones(3), (20,), rng), last_layer=rng.normal(size=(21, 3))
    )
    plan = plan_swap(CONFIG, old, rng.normal(size=(10, 3)), NetworkFeatures(wide), wide.last_layer, RADIUS, states(8))
    assert plan.W.shape == (21, 3)
    assert plan.jump < CONFIG.jump_max


def test_the_ring_keeps_the_newest():
    ring = RecentStates(4, SIGNAL_COUNT)
    now = np.full((SIGNAL_COUNT, 2), -1.0)
    assert ring.columns(now).shape == (SIGNAL_COUNT, 0)
    for value in range(6):
        ring.push(np.full(SIGNAL_COUNT, float(value)))
    assert sorted(ring.columns(now)[0].tolist()) == [-1.0, -1.0, 2.0, 3.0, 4.0, 5.0]


# --- in the controller -----------------------------------------------------------------------------------------------


def flying_augmentation(swap_config):
    """An augmentation that has adapted along a path for two seconds, its channel, and the columns it saw last."""
    config = AdaptiveConfig(
        kind="adaptive",
        features="network",
        law=AdaptationConfig(tracking_gain=5.0, composite_gain=10.0, bias_weight=1.0, leak=0.0, weight_norm_max=RADIUS),
        swap=swap_config,
    )
    scales = {name: SignalScale(offset=0.0, scale=1.0) for name in INPUTS}
    inputs = UntrainedFeatures(position_inputs=INPUTS, attitude_inputs=INPUTS, hidden=(16,), count=10, scales=scales)
    gains = ChannelGains(natural_frequency_rad_s=(4.0, 4.0, 5.0), damping=0.8)
    loop = SlopeLimits.of("position", gains, gains, SlopeShares(place=1.0, motion=1.0, turn=1.0))
    augmentation = AdaptiveAugmentation(config, gains, inputs, "position", np.random.default_rng(0), loop)
    state = ChannelState(dt=0.005, adapt=True, signals=np.zeros((SIGNAL_COUNT, 2)))
    for tick in range(400):
        for column, t in enumerate((tick * 0.005, tick * 0.005 + 0.17)):
            state.signals[ROWS, column] = np.sin(t), np.sin(2 * t), np.cos(t)
        state.residual[:] = 2.0 * state.signals[ROWS, 0]
        nu = augmentation.step(state, ChannelTelemetry())
    return augmentation, state, nu.copy()


@pytest.mark.parametrize(("swap_config", "smooth"), [(CONFIG, True), (SwapConfig(jump_max=1e9, naive=True), False)])
def test_the_commanded_nu_ad_does_not_jump_by_more_than_was_reported(swap_config, smooth):
    """Also at the state looked ahead to, where the vehicle has not been yet."""
    augmentation, state, before = flying_augmentation(swap_config)
    new = channel(77)
    features, plan = augmentation.plan(new)
    assert plan.refusal == ""
    augmentation.commit(features, plan)
    state.adapt = False
    telemetry = ChannelTelemetry()
    jump = float(np.linalg.norm(augmentation.step(state, telemetry) - before))
    assert jump <= plan.jump + 1e-9
    assert telemetry.eps_2 == plan.jump
    assert (jump < CONFIG.jump_max) is smooth


def test_the_law_learns_at_the_present_state_and_commands_at_the_one_ahead():
    augmentation, state, _ = flying_augmentation(CONFIG)
    state.residual[:] = 1.0, -2.0, 3.0
    telemetry = ChannelTelemetry()
    for _ in range(1000):  # now and ahead stay two different places
        nu = augmentation.step(state, telemetry)
    Phi = augmentation.features.evaluate(augmentation.features.select(state.signals))
    both = augmentation.last_layer.W.T @ Phi
    np.testing.assert_allclose(both[:, 0], state.residual, atol=1e-6)
    np.testing.assert_allclose(telemetry.adaptive_now, both[:, 0], atol=1e-12)
    np.testing.assert_allclose(nu, both[:, 1], atol=1e-12)
    ahead = float(np.linalg.norm(both[:, 1] - both[:, 0]))
    assert ahead > 0.05
    assert telemetry.eps_3 == pytest.approx(ahead)


def test_eps_1_settles_at_the_misfit():
    augmentation, state, _ = flying_augmentation(CONFIG)
    telemetry = ChannelTelemetry()
    augmentation.last_layer.W[:] = 0.0
    state.adapt = False
    augmentation._Delta_hat = (3.0, 0.0, -4.0)
    for _ in range(4000):
        augmentation.step(state, telemetry)
    assert telemetry.eps_1 == pytest.approx(5.0, rel=1e-3)
