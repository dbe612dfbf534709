"""The slope of a map: by differences, against the loop's gains, and flattened where it is too steep."""

import dataclasses

import numpy as np
import pytest

from onboard.control.features import NetworkFeatures
from onboard.control.reference_model import ChannelGains
from onboard.control.slope import SlopeLimits, SlopeShares, flattened, largest_shares, slopes
from protocol.conventions import GRAVITY
from protocol.signals import SIGNAL_COUNT
from tests.onboard.control.test_feature_swap import INPUTS, ROWS, channel, states

POSITION = ChannelGains(natural_frequency_rad_s=(4.0, 5.0, 6.0), damping=0.8)
ATTITUDE = ChannelGains(natural_frequency_rad_s=(16.0, 15.0, 5.0), damping=1.2)
GAINS = SlopeLimits.of("position", POSITION, ATTITUDE, SlopeShares(place=1.0, motion=1.0, turn=1.0))


def evaluated(source, theta, signals):
    features = NetworkFeatures(source)
    return theta.T @ features.evaluate(features.select(signals))


@pytest.mark.parametrize("seed", range(4))
def test_slopes_equal_differences(seed):
    source = dataclasses.replace(channel(seed), scale=np.array([0.5, 2.0, 0.7]), offset=np.array([0.1, -0.2, 0.0]))
    at, step = states(seed, n=9), 1e-6
    found = slopes(source, source.last_layer, at)
    assert found.shape == (9, 3, 3)
    for column, row in enumerate(ROWS):
        moved = at.copy()
        moved[row] += step
        difference = (evaluated(source, source.last_layer, moved) - evaluated(source, source.last_layer, at)) / step
        np.testing.assert_allclose(found[:, :, column].T, difference, rtol=1e-4, atol=1e-5)


def test_a_clipped_input_has_no_slope():
    at = np.full((SIGNAL_COUNT, 1), 50.0)
    np.testing.assert_array_equal(slopes(channel(0), channel(0).last_layer, at), 0.0)


def test_shares_are_of_the_gains_of_the_loop():
    source, at = channel(1), states(1)
    slope = slopes(source, source.last_layer, at)
    place = np.linalg.norm(slope[:, :, :2], axis=2).max(axis=0) / POSITION.stiffness()
    motion = np.abs(slope[:, :, 2]).max(axis=0) / POSITION.rate_gain()
    np.testing.assert_allclose(largest_shares(source, source.last_layer, GAINS, at), np.maximum(place, motion))


def test_in_the_attitude_channel_a_slope_over_the_place_counts_as_the_stiffness_it_becomes():
    gains = dict(SlopeLimits.of("attitude", POSITION, ATTITUDE, SlopeShares(place=1.0, motion=1.0, turn=1.0)).groups)
    place = gains["position_n", "position_e", "position_d"]
    # u += slope p tilts by slope p / K_1; that pushes g slope p / K_1: the loop's own is K_1 of the position channel.
    assert GRAVITY * place[1] / ATTITUDE.stiffness()[1] == pytest.approx(POSITION.stiffness()[0])
    assert GRAVITY * place[0] / ATTITUDE.stiffness()[0] == pytest.approx(POSITION.stiffness()[1])


@pytest.mark.parametrize("seed", range(6))
def test_a_steep_map_is_flattened_to_its_share_and_keeps_its_mean(seed):
    source, at = channel(seed, memory=200.0 * channel(seed).last_layer), states(seed)
    features = NetworkFeatures(source)
    Phi = features.evaluate(features.select(at))
    before = largest_shares(source, source.last_layer, GAINS, at)
    theta, factor = flattened(source.last_layer, before, Phi)
    assert before.max() > 1.0
    after = largest_shares(source, theta, GAINS, at)
    np.testing.assert_allclose(after, np.minimum(before, 1.0), rtol=1e-9)
    np.testing.assert_allclose(after, before * factor, rtol=1e-9)
    np.testing.assert_allclose((theta.T @ Phi).mean(axis=1), (source.last_layer.T @ Phi).mean(axis=1), atol=1e-9)


def test_a_flat_map_is_left_as_it_is():
    source, at = channel(2, memory=1e-3 * channel(2).last_layer), states(2)
    features = NetworkFeatures(source)
    shares = largest_shares(source, source.last_layer, GAINS, at)
    theta, _ = flattened(source.last_layer, shares, features.evaluate(features.select(at)))
    assert theta is source.last_layer
    assert len(INPUTS) == 3
