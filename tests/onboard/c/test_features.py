"""Features in real and in 16 bits, and the swap: the C core against numpy's."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.c.feature_arrays import put_selection
from onboard.c.library import Core
from onboard.control.feature_swap import RecentStates, SwapConfig, plan_swap, resemblance
from onboard.control.features import BiasFeatures, NetworkFeatures, RadialFeatures, random_channel
from protocol.feature_set import ChannelFeatures
from protocol.messages import REFUSALS
from protocol.signals import SIGNAL_COUNT, SIGNAL_NAMES
from tests.onboard.c.channels import INPUTS, c_channel, c_network_features, channel, signals
from tests.onboard.c.parity import SETTINGS, array, call, configured, real, same, view
from tests.onboard.control.fixture import FEATURES

WIDTHS = st.sampled_from([(19,), (32, 19), (32, 32, 19), (5, 7, 9, 3)])
SEEDS = st.integers(0, 2**31)


def evaluate(core: Core, ours: Any, theirs: Any, columns: Any) -> None:
    """Both cores at the same states."""
    z = theirs.select(columns.T)
    Phi = theirs.evaluate(z)
    for index, one in enumerate(columns):
        scaled = call(core, "features_select", ours, one, out=max(z.shape[0], 1))[: z.shape[0]]
        same(scaled, z[:, index], scale=1.0)
        same(call(core, "features_evaluate", ours, scaled, out=Phi.shape[0]), Phi[:, index])


@SETTINGS
@given(seed=SEEDS, widths=WIDTHS)
def test_network(core: Core, seed: int, widths: tuple[int, ...]) -> None:
    source = channel(seed, widths)
    ours, theirs = c_network_features(core, source), NetworkFeatures(source)
    assert ours.feature_count == theirs.feature_count
    evaluate(core, ours, theirs, signals(seed, 3))
    work = np.empty(2 * 128**2)
    lipschitz = core.network_lipschitz(ours.network, len(INPUTS), work)
    assert lipschitz == pytest.approx(theirs.lipschitz, rel=1e-9)


@SETTINGS
@given(seed=SEEDS, width=st.floats(0.1, 3.0))
def test_radial_functions(core: Core, seed: int, width: float) -> None:
    offset, scale = np.full(len(INPUTS), 0.1), np.full(len(INPUTS), 0.7)
    selection, ours = core.FeatureSelection(), core.Features()
    put_selection(selection, INPUTS, offset, scale)
    core.features_init_radial(ours, selection, width)
    theirs = RadialFeatures(INPUTS, offset, scale, width)
    assert ours.feature_count == theirs.feature_count
    evaluate(core, ours, theirs, signals(seed, 2, size=0.7))


def test_the_bias_alone(core: Core) -> None:
    ours = core.Features()
    core.features_init_bias(ours)
    evaluate(core, ours, BiasFeatures(), signals(1, 2))


def test_the_largest_network_and_as_many_inputs_as_signals(core: Core) -> None:
    rng = np.random.default_rng(3)
    start = random_channel(SIGNAL_NAMES, np.zeros(21), np.ones(21), (128, 128, 128, 128), rng)
    last_layer = rng.normal(size=(129, 3))
    source = ChannelFeatures(SIGNAL_NAMES, start.offset, start.scale, start.weights, start.biases, last_layer)
    evaluate(core, c_network_features(core, source), NetworkFeatures(source), signals(2, 2))


# --- their slope ---


def slope_both(core: Core, ours: Any, theirs: Any, state: Any, chosen: list[int]) -> None:
    """dPhi/dx over the chosen inputs at one state, [k - 1, n]."""
    z = theirs.select(np.stack([state, state], axis=1))
    theirs.evaluate(z)
    expected = theirs.slope(0, np.array(chosen))
    J, work = np.full(128 * len(chosen), np.nan), np.empty(128 * len(chosen))
    core.features_slope(ours, np.ascontiguousarray(z[:, 0]), np.array(chosen, np.int32), len(chosen), J, work)
    same(J[: expected.size], expected, 1e-11)


CHOSEN = st.lists(st.integers(0, len(INPUTS) - 1), min_size=1, max_size=len(INPUTS), unique=True)


@SETTINGS
@given(seed=SEEDS, widths=WIDTHS, chosen=CHOSEN, size=st.sampled_from([1.0, 6.0]))
def test_the_slope_of_a_network(core: Core, seed: int, widths: tuple[int, ...], chosen: list[int], size: float) -> None:
    """With the larger signals, some inputs are clipped."""
    source = channel(seed, widths)
    slope_both(core, c_network_features(core, source), NetworkFeatures(source), signals(seed, 1, size)[0], chosen)


@SETTINGS
@given(seed=SEEDS, width=st.floats(0.3, 3.0), chosen=CHOSEN, size=st.sampled_from([0.5, 3.0]))
def test_the_slope_of_radial_functions(core: Core, seed: int, width: float, chosen: list[int], size: float) -> None:
    offset, scale = np.full(len(INPUTS), 0.1), np.full(len(INPUTS), 0.7)
    selection, ours = core.FeatureSelection(), core.Features()
    put_selection(selection, INPUTS, offset, scale)
    core.features_init_radial(ours, selection, width)
    slope_both(core, ours, RadialFeatures(INPUTS, offset, scale, width), signals(seed, 1, size)[0], chosen)


def test_the_slope_of_the_largest_network_and_at_the_limit_of_an_input(core: Core) -> None:
    rng = np.random.default_rng(3)
    start = random_channel(SIGNAL_NAMES, np.zeros(21), np.ones(21), (128, 128, 128, 128), rng)
    state = rng.normal(size=SIGNAL_COUNT)
    state[:2] = 3.0, -3.0
    slope_both(core, c_network_features(core, start), NetworkFeatures(start), state, list(range(15)))


# --- 16 bits ---


def test_the_table_of_tanh(core: Core) -> None:
    x = np.linspace(-9.0, 9.0, 5001)
    ours = np.array([core.tanh_q15(round(one * 2**16)) for one in x]) / 2**15
    assert np.abs(ours - np.tanh(x)).max() < 1.5e-4
    assert core.tanh_q15(2**31 - 1) == -core.tanh_q15(1 - 2**31) == 32767


@pytest.mark.parametrize("side", ["position", "attitude"])
@pytest.mark.parametrize(("steeper", "least_lipschitz", "allowed"), [(1.0, 1.0, 1e-3), (3.0, 150.0, 3e-3)])
def test_features_in_16_bits(core: Core, side: str, steeper: float, least_lipschitz: float, allowed: float) -> None:
    """The networks that a flight starts with, and the same with weights three times as large.

    The latter have a Lipschitz constant near 200, the largest that a swap accepts by default. They were not trained.
    """
    untrained, worst, lipschitz = FEATURES.untrained, 0.0, 0.0
    names = untrained.inputs(side)
    offset, scale = untrained.offset_and_scale(names)
    for seed in range(8):
        rng = np.random.default_rng(seed)
        start = random_channel(names, offset, scale, (*untrained.hidden, untrained.count - 1), rng)
        weights = tuple(steeper * W for W in start.weights)
        source = ChannelFeatures(names, offset, scale, weights, start.biases, start.last_layer)
        ours, features, theirs = core.FeaturesQ15(), c_network_features(core, source), NetworkFeatures(source)
        assert core.features_q15_init(ours, features)
        lipschitz = max(lipschitz, theirs.lipschitz)
        for one in offset + scale * rng.uniform(-3, 3, (20, len(names))):
            state = np.zeros(SIGNAL_COUNT)
            state[view(features.selection.index)[: len(names)]] = one
            z = np.zeros(len(names), np.int16)
            Phi = np.zeros(untrained.count, np.int16)
            core.features_q15_select(ours, state, z)
            core.features_q15_evaluate(ours, z, Phi)
            exact = theirs.evaluate(theirs.select(state[:, None]))[:, 0]
            worst = max(worst, float(np.abs(Phi / 2**15 - exact).max()))
    assert lipschitz >= least_lipschitz
    assert worst <= allowed


def test_a_weight_too_large_for_16_bits_is_refused(core: Core) -> None:
    features = c_network_features(core, channel(1))
    features.network.parameters[3] = 4e4
    assert not core.features_q15_init(core.FeaturesQ15(), features)
    features.network.parameters[3] = 3e4
    assert core.features_q15_init(core.FeaturesQ15(), features)


# --- matrices ---


@SETTINGS
@given(seed=SEEDS, rows=st.integers(1, 12), columns=st.integers(1, 12))
def test_largest_singular_value(core: Core, seed: int, rows: int, columns: int) -> None:
    A = np.random.default_rng(seed).normal(size=(rows, columns))
    work = np.empty(2 * 144)
    ours = core.largest_singular_value(array(core, A), rows, columns, columns, work)
    assert ours == pytest.approx(np.linalg.norm(A, 2), rel=1e-9)


def test_singular_values_that_are_equal_zero_or_not_finite(core: Core) -> None:
    work = np.empty(32)
    for A in (np.eye(3), np.diag([2.0, 2.0, 1.0]), np.diag([1.0, 1.0 - 1e-9, 0.5])):
        assert core.largest_singular_value(array(core, A), 3, 3, 3, work) == pytest.approx(A.max(), rel=1e-8)
    assert core.largest_singular_value(np.zeros(9), 3, 3, 3, work) == 0.0
    assert math.isnan(core.largest_singular_value(np.full(9, np.nan), 3, 3, 3, work))


def test_a_matrix_that_is_not_positive_definite_has_no_solution(core: Core) -> None:
    assert not core.cholesky_solve(array(core, [[1.0, 2.0], [2.0, 1.0]]), np.ones(2), 2, 1)
    assert not core.cholesky_solve(np.full(4, np.nan), np.ones(2), 2, 1)
    x = np.array([1.0, 2.0])
    assert core.cholesky_solve(array(core, [[2.0, 1.0], [1.0, 3.0]]), x, 2, 1)
    same(x, np.linalg.solve([[2.0, 1.0], [1.0, 3.0]], [1.0, 2.0]))


# --- swap ---


def swap_config(**values: Any) -> SwapConfig:
    return SwapConfig(**{"jump_max": 3.0, "ring_size": 10, **values})


@SETTINGS
@given(
    seed=SEEDS,
    kept=st.integers(0, 12),
    widths=WIDTHS,
    gain=st.sampled_from([0.3, 1.0, 3.0]),
    limits=st.fixed_dictionaries({"jump_max": st.floats(0.01, 9.0), "naive": st.booleans()}),
    norm_max=st.sampled_from([5.0, 40.0]),
)
def test_swap(
    core: Core, seed: int, kept: int, widths: tuple[int, ...], gain: float, limits: Any, norm_max: float
) -> None:
    config = swap_config(**limits)
    old, new = channel(seed), channel(seed + 1 if seed % 2 else seed, widths, gain)
    W = np.random.default_rng(seed).normal(size=(20, 3))
    now, ring = signals(seed + 2, 2).T, RecentStates(10, SIGNAL_COUNT)
    ours_ring = core.RecentStates()
    core.recent_init(ours_ring, 10)
    for one in signals(seed + 3, kept):
        residual = (one[0], -one[1], 2.0)
        ring.push(one, residual)
        core.recent_push(ours_ring, array(core, one), array(core, residual))
    same_ring(core, ours_ring, ring)
    columns = ring.columns(now)
    expected = plan_swap(config, NetworkFeatures(old), W, NetworkFeatures(new), new.last_layer, norm_max, columns)
    work, plan = core.SwapWorkspace(), core.SwapPlan()
    n = core.recent_states(ours_ring, array(core, now[:, 0]), array(core, now[:, 1]), view(work.states))
    assert n == columns.shape[1]
    core.plan_swap(
        configured(core, config),
        c_network_features(core, old),
        array(core, W),
        c_network_features(core, new),
        array(core, new.last_layer),
        norm_max,
        n,
        work,
        plan,
    )
    assert REFUSALS[plan.refusal] == expected.refusal
    same(view(plan.W)[: expected.W.size], expected.W, rtol=1e-9)
    same(view(plan.theta)[: expected.W.size], expected.theta)
    assert plan.jump == pytest.approx(expected.jump, rel=1e-9, abs=1e-9)
    assert plan.step == pytest.approx(expected.step, rel=1e-9, abs=1e-9)


def same_ring(core: Core, ours: Any, theirs: RecentStates) -> None:
    states, residuals = np.empty((200, SIGNAL_COUNT)), np.empty((200, 3))
    n = core.recent_in_order(ours, states, residuals)
    in_order, measured = theirs.in_order()
    np.testing.assert_array_equal(states[:n], in_order.T)
    np.testing.assert_array_equal(residuals[:n], measured)


@SETTINGS
@given(seed=SEEDS, near=st.booleans())
def test_resemblance(core: Core, seed: int, near: bool) -> None:
    rng = np.random.default_rng(seed)
    Phi = rng.normal(size=(6, 4))
    other = Phi + (0.1 if near else 2.0) * rng.normal(size=(6, 4))
    ours = core.resemblance(array(core, Phi), array(core, other), 6, 4)
    assert ours == pytest.approx(resemblance(Phi, other), rel=1e-12)


def test_a_swap_that_is_not_finite_is_refused(core: Core) -> None:
    new = c_channel(core, channel(2))
    old, features, work, plan = (
        c_network_features(core, channel(1)),
        core.Features(),
        core.SwapWorkspace(),
        core.SwapPlan(),
    )
    core.features_init_network(features, new.selection, new.network)
    W = np.full(60, np.nan, real(core))
    core.plan_swap(configured(core, swap_config()), old, W, features, new.last_layer, 40.0, 2, work, plan)
    assert REFUSALS[plan.refusal] == "not_finite"


def test_one_state_that_is_not_finite_is_enough_to_refuse(core: Core) -> None:
    """Also a naive swap, which solves nothing, and whose other states are finite."""
    old, new = channel(1), channel(2)
    states, W = signals(1, 3), np.ones((20, 3))
    states[0] = np.nan
    config = swap_config(naive=True, jump_max=1e9)
    expected = plan_swap(config, NetworkFeatures(old), W, NetworkFeatures(new), new.last_layer, 40.0, states.T)
    work, plan = core.SwapWorkspace(), core.SwapPlan()
    view(work.states)[: states.size] = states.reshape(-1)
    ours = [c_network_features(core, one) for one in (old, new)]
    core.plan_swap(configured(core, config), ours[0], array(core, W), ours[1], ours[1].last_layer, 40.0, 3, work, plan)
    assert REFUSALS[plan.refusal] == expected.refusal == "not_finite"
