"""A core that evaluates its networks in 16-bit whole numbers (-DDMRAC_Q15_FEATURES), against the same core in float."""

from typing import Any

import numpy as np
import pytest

from onboard.c.compile import Variant
from onboard.c.library import Core, load
from onboard.control.features import random_channel
from protocol.feature_set import ChannelFeatures
from protocol.signals import SIGNAL_COUNT
from tests.onboard.c.channels import c_network_features
from tests.onboard.c.conftest import OPTIONS
from tests.onboard.c.parity import view
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
