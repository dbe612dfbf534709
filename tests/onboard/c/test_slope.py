"""The slope of a map, and its limits by the loop's gains: the C core against numpy's."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.c.library import Core
from onboard.control.features import NetworkFeatures
from onboard.control.reference_model import ChannelGains
from onboard.control.slope import PLACE, SlopeLimits, SlopeShares, flattened, largest_shares, slopes
from protocol.feature_config import ChannelName
from protocol.feature_set import WIDTH_MAX
from protocol.signals import SIGNAL_INDEX
from tests.onboard.c.channels import INPUTS, c_network_features, channel, signals
from tests.onboard.c.parity import SETTINGS, array, call, configured, same, view

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
def test_flattened(core: Core, seed: int, widths: tuple[int, ...], side: int, n: int, share: float) -> None:
    source, at = channel(seed, widths), signals(seed, n)
    limits, their_limits = slope_limits(core, side, share)
    features, theirs = c_network_features(core, source), NetworkFeatures(source)
    shares = np.empty(3)
    core.largest_shares(features, array(core, source.last_layer), limits, array(core, at), n, shares)
    same(shares, largest_shares(source, source.last_layer, their_limits, at.T), rtol=1e-11)
    Phi, k = theirs.evaluate(theirs.select(at.T)), source.feature_count
    ours = np.empty((k, n))
    core.features_of_states(features, array(core, at), n, ours)
    same(ours, Phi, rtol=1e-11)
    before = largest_shares(source, source.last_layer, their_limits, at.T)
    expected, factor = flattened(source.last_layer, before, Phi)
    theta, rows = source.last_layer.copy(), np.zeros((n, WIDTH_MAX + 1))
    rows[:, :k] = Phi.T
    core.flattened(shares, rows, n, k, theta)
    same(theta, expected, rtol=1e-11)
    same(shares, before * factor, rtol=1e-11)


def test_a_state_that_is_not_finite_leaves_no_finite_share(core: Core) -> None:
    """It must not vanish between finite ones."""
    source, at = channel(1), signals(1, 3)
    at[1] = np.nan
    limits, their_limits = slope_limits(core, 0)
    features, shares = c_network_features(core, source), np.empty(3)
    core.largest_shares(features, array(core, source.last_layer), limits, array(core, at), 3, shares)
    assert np.isnan(shares).all()
    assert np.isnan(largest_shares(source, source.last_layer, their_limits, at.T)).all()
