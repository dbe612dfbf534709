"""A core that evaluates its networks in 16-bit whole numbers (-DDMRAC_Q15_FEATURES), against the same core in float."""

from typing import Any

import numpy as np
import pytest

from onboard.c.compile import Variant
from onboard.c.library import Core, load
from onboard.control.features import random_channel
from onboard.control.reference_model import ChannelGains
from onboard.control.slope import SlopeShares
from protocol.feature_set import ChannelFeatures
from protocol.signals import SIGNAL_COUNT
from tests.onboard.c.channels import c_network_features
from tests.onboard.c.conftest import OPTIONS
from tests.onboard.c.parity import configured, view
from tests.onboard.control.fixture import FEATURES


@pytest.fixture(scope="module")
def whole() -> Core:
    return load(Variant("float", (*OPTIONS, "-DDMRAC_Q15_FEATURES")))


def random_features(core: Core, side: str, seed: int, steeper: float) -> tuple[Any, Any, int]:
    """Features of a random network, a random state within and beyond the inputs' scales, and the number of inputs."""
    untrained, rng = FEATURES.untrained, np.random.default_rng(seed)
    names = untrained.inputs(side)
    offset, scale = untrained.offset_and_scale(names)
    start = random_channel(names, offset, scale, (*untrained.hidden, untrained.count - 1), rng)
    weights = tuple(steeper * W for W in start.weights)
    source = ChannelFeatures(names, offset, scale, weights, start.biases, start.last_layer)
    features = c_network_features(core, source)
    state = np.zeros(SIGNAL_COUNT, np.float32)
    state[view(features.selection.index)[: len(names)]] = offset + scale * rng.uniform(-1.5, 1.5, len(names))
    return features, state, len(names)


def evaluated(core: Core, side: str, seed: int, steeper: float) -> tuple[Any, Any]:
    """Phi [k] and J [k - 1, m], float32."""
    features, state, inputs = random_features(core, side, seed, steeper)
    z, Phi = np.zeros(inputs, np.float32), np.zeros(features.feature_count, np.float32)
    chosen = np.arange(inputs, dtype=np.int32)
    J = np.zeros((128 * inputs), np.float32)
    work = np.zeros(128 * inputs, np.float32)
    core.features_select(features, state, z)
    core.features_evaluate(features, z, Phi)
    core.features_slope(features, z, chosen, inputs, J, work)
    return Phi, J[: (features.feature_count - 1) * inputs]


@pytest.mark.parametrize("side", ["position", "attitude"])
@pytest.mark.parametrize(("steeper", "allowed"), [(1.0, 5e-4), (3.0, 2e-3)])
def test_features_and_their_slopes(core32: Core, whole: Core, side: str, steeper: float, allowed: float) -> None:
    for seed in range(12):
        Phi, J = evaluated(whole, side, seed, steeper)
        exact, exact_J = evaluated(core32, side, seed, steeper)
        assert np.abs(Phi - exact).max() <= allowed
        assert Phi[-1] == 1.0
        assert np.abs(J - exact_J).max() <= 2.0 * allowed * np.abs(exact_J).max() + 1e-3
        assert not np.array_equal(Phi, exact)  # it is the other way to compute them


def test_a_network_with_large_weights_is_evaluated_in_float(core32: Core, whole: Core) -> None:
    Phi, J = evaluated(whole, "position", 1, 1e6)
    exact, exact_J = evaluated(core32, "position", 1, 1e6)
    assert np.array_equal(Phi, exact)
    assert np.array_equal(J, exact_J)


@pytest.mark.parametrize("side", ["position", "attitude"])
@pytest.mark.parametrize("steeper", [0.1, 1.0, 3.0])
def test_spectral_norms_of_the_layers(whole: Core, side: str, steeper: float) -> None:
    """Within 2 %, and never larger by more than rounding."""
    for seed in range(8):
        features, _, inputs = random_features(whole, side, seed, steeper)
        work, network, at = whole.NormWorkspace(), features.network, 0
        for layer in range(network.layers):
            rows = network.width[layer]
            W = view(network.parameters)[at : at + rows * (inputs + 1)].reshape(rows, inputs + 1)[:, :-1]
            norm = np.linalg.norm(W.astype(np.float64), 2)
            assert 0.95 * norm <= whole.features_layer_norm(features, layer, work) <= 1.001 * norm
            at, inputs = at + rows * (inputs + 1), rows


@pytest.mark.parametrize("side", [0, 1])
def test_shares_of_the_slope(core32: Core, whole: Core, side: int) -> None:
    """Of a map, at states within and beyond the inputs' scales."""
    gains = ChannelGains(natural_frequency_rad_s=(3.0, 3.0, 5.0), damping=0.8)
    shares_of_gains = SlopeShares(place=1.0, motion=1.0, turn=1.0)
    for seed in range(12):
        found = []
        for core in (core32, whole):
            features, state, _ = random_features(core, ("position", "attitude")[side], seed, 2.0)
            limits, shares = core.SlopeLimits(), np.zeros(3, np.float32)
            configured_gains = configured(core, gains)
            core.slope_limits_of(side, configured_gains, configured_gains, configured(core, shares_of_gains), limits)
            theta = np.random.default_rng(seed).normal(size=(features.feature_count, 3)).astype(np.float32)
            core.largest_shares(features, theta, limits, state, 1, shares)
            found.append(shares.copy())
        assert np.abs(found[1] - found[0]).max() <= 5e-3 * found[0].max() + 1e-3


def test_a_map_that_is_not_finite_has_no_finite_share(whole: Core) -> None:
    gains, shares = ChannelGains(natural_frequency_rad_s=(3.0, 3.0, 5.0), damping=0.8), np.zeros(3, np.float32)
    features, state, _ = random_features(whole, "position", 1, 1.0)
    limits, own = whole.SlopeLimits(), configured(whole, gains)
    whole.slope_limits_of(0, own, own, configured(whole, SlopeShares(place=1.0, motion=1.0, turn=1.0)), limits)
    theta = np.full((features.feature_count, 3), np.nan, np.float32)
    whole.largest_shares(features, theta, limits, state, 1, shares)
    assert not np.isfinite(shares).any()
