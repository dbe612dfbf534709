"""The bound of W's slope in flight: the C core against numpy's."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.c.feature_arrays import put_selection
from onboard.c.library import Core
from onboard.control.features import Features, NetworkFeatures, RadialFeatures, random_channel
from onboard.control.laws.kalman_state import KalmanState, multiplier
from onboard.control.laws.slope_bound import PERIOD_TICKS, SlopeBound, bound_slopes
from onboard.control.slope import SlopeLimits, SlopeShares
from protocol.signals import SIGNAL_COUNT, SIGNAL_NAMES
from tests.onboard.c.channels import c_network_features, signals
from tests.onboard.c.parity import SETTINGS, array, configured, same, view
from tests.onboard.c.test_kalman import covariance
from tests.onboard.c.test_laws import GAINS
from tests.onboard.c.test_slope import SIDES

SEEDS = st.integers(0, 2**31)
NAMES = st.lists(st.sampled_from(SIGNAL_NAMES), min_size=1, max_size=21, unique=True).map(tuple)


def definite(rng: np.random.Generator, n: int, spread: float) -> Any:
    """A symmetric matrix [n, n] with eigenvalues from exp(-spread) to 1."""
    axes, _ = np.linalg.qr(rng.normal(size=(n, n)))
    S = axes @ np.diag(np.exp(-rng.uniform(0.0, spread, n))) @ axes.T
    return 0.5 * (S + S.T)


@SETTINGS
@given(
    seed=SEEDS,
    n=st.integers(1, 15),
    columns=st.sampled_from([1, 3]),
    far=st.sampled_from([1.0001, 3.0, 1e3]),
    spread=st.sampled_from([0.0, 6.0, 12.0]),
)
def test_the_multiplier(core: Core, seed: int, n: int, columns: int, far: float, spread: float) -> None:
    rng = np.random.default_rng(seed)
    S, X, radius = definite(rng, n, spread), rng.normal(size=(n, columns)), 0.7
    X *= far * radius / np.linalg.norm(X)
    s, axes = np.linalg.eigh(S)
    along = axes.T @ X
    mu = multiplier(np.square(along).sum(axis=1), s, radius)
    Y = np.empty((n, columns))
    assert core.multiplier(S, X, n, columns, radius, Y, np.empty(n * n)) == pytest.approx(mu, rel=1e-9)
    same(Y, axes @ (along / (1.0 + mu * s)[:, None]), 1e-10)
    assert np.linalg.norm(Y) == pytest.approx(radius, rel=1e-8)


@pytest.mark.parametrize("S", [[[-1.0]], [[np.nan]], [[np.inf]], [[1.0, 2.0], [2.0, 1.0]], [[0.0, 0.0], [0.0, 0.0]]])
def test_the_multiplier_of_a_matrix_that_is_no_covariance_only_shrinks(core: Core, S: Any) -> None:
    n = len(S)
    X, Y = np.full(n, 5.0), np.empty(n)
    mu = core.multiplier(array(core, S), X, n, 1, 1.0, Y, np.empty(n * n))
    assert np.isfinite(mu)
    assert mu >= 0.0
    assert np.linalg.norm(Y) <= np.linalg.norm(X)


def both_states(core: Core, seed: int, k: int, size: float) -> tuple[Any, KalmanState, Any]:
    """The state of a law in both cores, theta [k, 3] included, with a covariance of large and small axes."""
    rng, n = np.random.default_rng(seed), k + 1
    ours, theirs = core.KalmanState(), KalmanState(rng.normal(size=(n, 3)), np.ones(n), np.ones(n))
    core.kalman_state_init(ours, array(core, np.ones(n)), array(core, np.ones(n)), n)
    theirs.S[:], theirs.X_rows[:] = definite(rng, n, 8.0), size * rng.normal(size=(3, n))
    view(ours.S)[: n * n], view(ours.X)[: 3 * n] = theirs.S.reshape(-1), theirs.X_rows.T.reshape(-1)
    return ours, theirs, rng


def same_weights(ours: Any, theirs: KalmanState, rtol: float) -> None:
    X, n = theirs.X_rows.T, theirs.S.shape[0]
    same(view(ours.X)[: X.size], X, rtol)
    same(covariance(ours), theirs.S, 0.0 if view(ours.X).dtype == np.float64 else 1e-6)
    assert ours.size == n


@SETTINGS
@given(
    seed=SEEDS,
    k=st.sampled_from([2, 6, 20]),
    n=st.sampled_from([1, 3, 15]),
    share=st.sampled_from([0.01, 1.0, 3.0, 30.0]),
    size=st.sampled_from([0.1, 3.0]),
)
def test_the_projection(core: Core, seed: int, k: int, n: int, share: float, size: float) -> None:
    """Also where some axes are within their limit and others are not."""
    ours, theirs, rng = both_states(core, seed, k, size)
    J, units, work = rng.normal(size=(k - 1, n)), rng.uniform(0.1, 3.0, (3, n)) / share, core.SlopeWorkspace()
    view(work.J)[: J.size] = J.reshape(-1)
    core.bound_slopes(ours, array(core, theirs.theta_rows.T), array(core, units), n, work)
    bound_slopes(theirs, J, units)
    same_weights(ours, theirs, 1e-9)


def test_what_the_projection_reaches() -> None:
    """All axes too steep, some of them, and none."""
    found = set()
    for share in (0.01, 1.0, 3.0, 30.0):
        for seed in range(5):
            rng = np.random.default_rng(seed)
            state = KalmanState(rng.normal(size=(7, 3)), np.ones(7), np.ones(7))
            before = state.X_rows.copy()
            bound_slopes(state, rng.normal(size=(5, 3)), rng.uniform(0.1, 3.0, (3, 3)) / share)
            found.add(int((state.X_rows != before).any(axis=1).sum()))
    assert {0, 3} < found


def limits_of(core: Core, side: int, share: float) -> tuple[Any, SlopeLimits]:
    shares, ours, gains = (
        SlopeShares(place=share, motion=share, turn=share),
        core.SlopeLimits(),
        configured(core, GAINS),
    )
    core.slope_limits_of(side, gains, gains, configured(core, shares), ours)
    return ours, SlopeLimits.of(SIDES[side], GAINS, GAINS, shares)


@SETTINGS
@given(names=NAMES, side=st.integers(0, 1))
def test_the_inputs_that_a_loop_knows(core: Core, names: tuple[str, ...], side: int) -> None:
    ours, selection, (limits, their_limits) = core.SlopeBound(), core.FeatureSelection(), limits_of(core, side, 0.4)
    put_selection(selection, names, np.zeros(len(names)), np.ones(len(names)))
    core.slope_bound_init(ours, selection, limits)
    theirs = SlopeBound(names, their_limits)
    n = theirs._inputs.size
    assert ours.count == n
    np.testing.assert_array_equal(view(ours.inputs)[:n], theirs._inputs)
    same(view(ours.units)[: 3 * n], theirs._units if n else [])


def features_of(core: Core, kind: str, seed: int) -> tuple[Any, Features]:
    """A network of nearly all signals, or radial functions of them."""
    rng, names = np.random.default_rng(seed), SIGNAL_NAMES[::-1][:18]
    offset, scale = rng.normal(size=18), rng.uniform(0.3, 2.0, 18)
    if kind == "network":
        source = random_channel(names, offset, scale, (16, 9, 12), rng)
        return c_network_features(core, source), NetworkFeatures(source)
    selection, ours = core.FeatureSelection(), core.Features()
    put_selection(selection, names, offset, scale)
    core.features_init_radial(ours, selection, 0.6)
    return ours, RadialFeatures(names, offset, scale, 0.6)


@pytest.mark.parametrize("kind", ["network", "radial"])
@SETTINGS
@given(seed=SEEDS, side=st.integers(0, 1), share=st.sampled_from([1e-3, 0.1, 10.0]))
def test_some_ticks(core: Core, kind: str, seed: int, side: int, share: float) -> None:
    """Every PERIOD_TICKS-th tick bounds the slope, at the signals of that tick."""
    c_features, features = features_of(core, kind, seed)
    k = features.feature_count
    ours, theirs, _ = both_states(core, seed, k, 1.0)
    limits, their_limits = limits_of(core, side, share)
    c_bound, bound = core.SlopeBound(), SlopeBound(features.inputs, their_limits)
    core.slope_bound_init(c_bound, c_features.selection, limits)
    theta, at = array(core, theirs.theta_rows.T), signals(seed, 2 * PERIOD_TICKS + 1, 1.0)
    for one in at:
        theirs.X_rows[:] += 0.1
        view(ours.X)[: 3 * (k + 1)] += 0.1
        features.evaluate(features.select(np.stack([one, one], axis=1)))
        bound.step(features, theirs)
        core.slope_bound_step(c_bound, c_features, array(core, one), theta, ours)
        same_weights(ours, theirs, 1e-9)


def test_features_without_inputs_that_a_loop_knows(core: Core) -> None:
    ours, _, _ = both_states(core, 1, 1, 50.0)
    features, bound, before = core.Features(), core.SlopeBound(), view(ours.X).copy()
    core.features_init_bias(features)
    core.slope_bound_init(bound, features.selection, limits_of(core, 0, 1e-6)[0])
    for _ in range(PERIOD_TICKS):
        core.slope_bound_step(bound, features, np.zeros(SIGNAL_COUNT), np.ones(3), ours)
    np.testing.assert_array_equal(view(ours.X), before)


@SETTINGS
@given(seed=SEEDS, share=st.sampled_from([0.3, 3.0]))
def test_in_float_the_bound_stays_near_that_in_double(core32: Core, seed: int, share: float) -> None:
    k, n = 20, 9
    ours, theirs, rng = both_states(core32, seed, k, 1.0)
    J, units, work = rng.normal(size=(k - 1, n)), rng.uniform(0.3, 3.0, (3, n)) / share, core32.SlopeWorkspace()
    view(work.J)[: J.size] = J.reshape(-1)
    core32.bound_slopes(ours, array(core32, theirs.theta_rows.T), array(core32, units), n, work)
    bound_slopes(theirs, J, units)
    same_weights(ours, theirs, 1e-3)
    slope = (theirs.theta_rows + view(ours.X)[: 3 * (k + 1)].reshape(k + 1, 3).T)[:, :-2] @ J * units
    assert np.linalg.norm(slope, axis=1).max() < 1.001
