"""The slope of a map, its limits by the loop's gains, and the posterior of a swap: the C core against numpy's."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.c.library import Core
from onboard.control.features import NetworkFeatures
from onboard.control.laws.kalman_last_layer import prior_variance
from onboard.control.posterior_swap import posterior
from onboard.control.reference_model import ChannelGains
from onboard.control.slope import PLACE, SlopeLimits, SlopeShares, bounded_theta, largest_shares, slopes
from protocol.feature_config import ChannelName
from protocol.signals import SIGNAL_INDEX
from tests.onboard.c.channels import INPUTS, c_network_features, channel, signals
from tests.onboard.c.parity import SETTINGS, array, call, configured, same, view
from tests.onboard.c.test_kalman import covariance, kalman_config, layers
from tests.onboard.control.fixture import DT

POSITION = ChannelGains(natural_frequency_rad_s=(4.0, 5.0, 6.0), damping=0.8)
ATTITUDE = ChannelGains(natural_frequency_rad_s=(16.0, 15.0, 5.0), damping=1.2)
WIDTHS = st.sampled_from([(19,), (32, 19), (32, 32, 19), (5, 7, 9, 3)])
SEEDS = st.integers(0, 2**31)
SIDES: tuple[ChannelName, ...] = ("position", "attitude")


def slope_limits(core: Core, side: int, share: float = 1.0) -> tuple[Any, SlopeLimits]:
    """Of both cores; the kinds of input differ in their shares."""
    ours, shares = core.SlopeLimits(), SlopeShares(place=5.0 * share, motion=2.0 * share, turn=share)
    core.slope_limits_of(side, configured(core, POSITION), configured(core, ATTITUDE), configured(core, shares), ours)
    return ours, SlopeLimits.of(SIDES[side], POSITION, ATTITUDE, shares)


@pytest.mark.parametrize("side", [0, 1])
def test_slope_limits(core: Core, side: int) -> None:
    ours, theirs = slope_limits(core, side)
    assert ours.groups == len(theirs.groups)
    for index, (names, limit) in enumerate(theirs.groups):
        first = ours.first[index]
        assert [SIGNAL_INDEX[name] for name in names] == [first, first + 1, first + 2]
        same(view(ours.limit)[3 * index : 3 * index + 3], limit)
        same(np.ctypeslib.as_array(core.slope_limits_at(ours, first), (3,)), limit)
    place = next(limit for names, limit in theirs.groups if names == PLACE)
    same(np.ctypeslib.as_array(core.slope_limits_at(ours, core.SIGNAL_POSITION_N), (3,)), place)
    assert not core.slope_limits_at(ours, core.SIGNAL_BATTERY_VOLTAGE)


@SETTINGS
@given(seed=SEEDS, widths=WIDTHS)
def test_slopes(core: Core, seed: int, widths: tuple[int, ...]) -> None:
    source, at = channel(seed, widths), signals(seed, 4)
    at[0, SIGNAL_INDEX["rate_r"]] = 1e3  # clipped
    expected = slopes(source, source.last_layer, at.T)
    features = c_network_features(core, source)
    for state, slope in zip(at, expected, strict=True):
        ours = call(core, "slopes", features, source.last_layer, state, out=3 * len(INPUTS))
        same(ours, slope, rtol=1e-11)
    assert (expected[0, :, INPUTS.index("rate_r")] == 0.0).all()


@SETTINGS
@given(
    seed=SEEDS,
    widths=WIDTHS,
    side=st.sampled_from([0, 1]),
    n=st.sampled_from([1, 12]),
    share=st.sampled_from([1e-3, 0.05, 0.5, 10.0]),
)
def test_bounded_theta(core: Core, seed: int, widths: tuple[int, ...], side: int, n: int, share: float) -> None:
    source, at = channel(seed, widths), signals(seed, n)
    limits, their_limits = slope_limits(core, side, share)
    features, theirs = c_network_features(core, source), NetworkFeatures(source)
    shares = np.empty(3)
    core.largest_shares(features, array(core, source.last_layer), limits, array(core, at), n, shares)
    same(shares, largest_shares(source, source.last_layer, their_limits, at.T), rtol=1e-11)
    Phi = theirs.evaluate(theirs.select(at.T))
    ours = np.empty((source.feature_count, n))
    core.features_of_states(features, array(core, at), n, ours)
    same(ours, Phi, rtol=1e-11)
    expected, _ = bounded_theta(source, their_limits, at.T, Phi)
    theta = np.empty(expected.shape)
    core.bounded_theta(features, features.last_layer, limits, array(core, at), ours, n, theta)
    same(theta, expected, rtol=1e-11)


def test_a_state_that_is_not_finite_leaves_no_finite_share(core: Core) -> None:
    """It must not vanish between finite ones."""
    source, at = channel(1), signals(1, 3)
    at[1] = np.nan
    limits, their_limits = slope_limits(core, 0)
    features, shares = c_network_features(core, source), np.empty(3)
    core.largest_shares(features, array(core, source.last_layer), limits, array(core, at), 3, shares)
    assert np.isnan(shares).all()
    assert np.isnan(largest_shares(source, source.last_layer, their_limits, at.T)).all()


@SETTINGS
@given(
    seed=SEEDS,
    n=st.integers(0, 40),
    k=st.sampled_from([2, 7, 20]),
    rate=st.floats(0.01, 20.0),
    noise=st.sampled_from([0.05, 0.5, 8.0]),
)
def test_the_posterior(core: Core, seed: int, n: int, k: int, rate: float, noise: float) -> None:
    """numpy solves for all states at once, C runs the filter over them: the same X and S."""
    rng = np.random.default_rng(seed)
    ours, theirs = layers(core, kalman_config(fast_bias_rate=rate, noise=noise), k)
    Phi, y, theta = np.tanh(rng.normal(size=(k, n + 2))), rng.normal(size=(n, 3)), rng.normal(size=(k, 3))
    Phi[-1] = 1.0
    spans = (DT, 5 * DT, 2 * DT)
    X, S = posterior(theirs, prior_variance(theirs.config, k), Phi[:, :n], y - Phi[:, :n].T @ theta, spans)
    times, state = core.SwapTimes(*spans), core.KalmanState()
    core.posterior(ours, theta, array(core, Phi), n + 2, k, array(core, y), n, times, state)
    same(view(state.X)[: X.size], X, rtol=1e-9)
    same(covariance(state), S, rtol=1e-9)
