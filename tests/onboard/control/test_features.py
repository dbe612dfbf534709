"""Features: numpy equals torch, the Lipschitz bound holds, inputs are scaled and clipped, the last one is constant."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.control.features import (
    INPUT_LIMIT,
    BiasFeatures,
    NetworkFeatures,
    RadialFeatures,
    halton,
    random_channel,
    silenced,
)
from protocol.feature_codec import decode_feature_set, encode_feature_set
from protocol.feature_set import ChannelFeatures, FeatureSet
from protocol.signals import SIGNAL_COUNT, SIGNAL_INDEX

INPUTS = ("position_n", "velocity_e", "motor_thrust_3", "battery_voltage", "rate_r")
SETTINGS = settings(max_examples=60, deadline=None, derandomize=True)


def channel(seed, widths=(32, 32, 19), gain=1.0):
    rng = np.random.default_rng(seed)
    start = random_channel(INPUTS, rng.normal(size=5), rng.uniform(0.1, 2.0, 5), widths, rng)
    weights = tuple(gain * W for W in start.weights)
    last_layer = rng.normal(size=start.last_layer.shape)
    return ChannelFeatures(INPUTS, start.offset, start.scale, weights, start.biases, last_layer)


def torch_network(features, dtype):
    layers = []
    for W, b in zip(features.weights, features.biases, strict=True):
        linear = torch.nn.Linear(W.shape[1], W.shape[0], dtype=dtype)
        with torch.no_grad():
            linear.weight.copy_(torch.tensor(W))
            linear.bias.copy_(torch.tensor(b))
        layers += [linear, torch.nn.Tanh()]
    return torch.nn.Sequential(*layers)


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float64, 1e-13), (torch.float32, 2e-6)])
@pytest.mark.parametrize("widths", [(19,), (32, 19), (32, 32, 19)])
def test_numpy_features_equal_torchs(dtype, tolerance, widths):
    source = channel(1, widths)
    features = NetworkFeatures(source)
    z = np.random.default_rng(2).uniform(-3, 3, (5, 200))
    ours = features.evaluate(z)
    with torch.no_grad():
        theirs = torch_network(source, dtype)(torch.tensor(z.T, dtype=dtype)).numpy().T
    np.testing.assert_allclose(ours[:-1], theirs, atol=tolerance)
    np.testing.assert_array_equal(ours[-1], 1.0)


def test_of_silenced_features_only_the_constant_is_left():
    source = channel(1)
    Phi = NetworkFeatures(silenced(source)).evaluate(np.random.default_rng(2).uniform(-3, 3, (5, 20)))
    assert Phi.shape == (20, 20)
    assert not Phi[:-1].any()
    np.testing.assert_array_equal(Phi[-1], 1.0)


def test_features_survive_the_wire():
    source = channel(4)
    sent = FeatureSet(3, 2, 100, source, None)
    got = decode_feature_set(encode_feature_set(sent, "float32")).position
    z = np.random.default_rng(5).uniform(-3, 3, (5, 50))
    ours, theirs = NetworkFeatures(source).evaluate(z), NetworkFeatures(got).evaluate(z)
    np.testing.assert_allclose(ours, theirs, atol=1e-5)


def radial(width=0.6):
    return RadialFeatures(INPUTS, np.zeros(5), np.ones(5), width)


@SETTINGS
@given(st.integers(0, 2**32 - 1), st.floats(0.2, 3.0), st.floats(1e-6, 3.0))
def test_the_lipschitz_bound_of_a_network_holds(seed, gain, distance):
    features = NetworkFeatures(channel(seed, gain=gain))
    check_lipschitz(features, seed, distance)


@SETTINGS
@given(st.integers(0, 2**32 - 1), st.floats(0.1, 2.0), st.floats(1e-6, 3.0))
def test_the_lipschitz_bound_of_radial_features_holds(seed, width, distance):
    check_lipschitz(radial(width), seed, distance)


def check_lipschitz(features, seed, distance):
    rng = np.random.default_rng(seed)
    a = rng.uniform(-2, 2, (5, 30))
    step = rng.normal(size=(5, 30))
    b = a + distance * step / np.linalg.norm(step, axis=0)
    change = np.linalg.norm(features.evaluate(a) - features.evaluate(b), axis=0)
    # Rounding of exp() is seen at the smallest distances.
    assert (change <= features.lipschitz * np.linalg.norm(a - b, axis=0) + 1e-12).all()


def test_one_gaussian_attains_its_share_of_the_bound():
    """The bound is not idle: at one standard deviation from its centre a Gaussian is as steep as it says."""
    features = RadialFeatures(INPUTS, np.zeros(5), np.ones(5), 0.6, count=1)
    sigma = 0.6 * 5**0.5
    centre = 2.0 * halton(1, 5)[0] - 1.0
    at = centre[:, None] + np.eye(5)[:, :1] * (sigma + np.array([-1e-5, 1e-5]))
    slope = abs(float(np.diff(features.evaluate(at)[0])[0])) / 2e-5
    assert slope == pytest.approx(features.lipschitz, rel=1e-6)


def test_the_bound_is_the_product_of_the_spectral_norms():
    source = channel(7)
    expected = np.prod([np.linalg.svd(W, compute_uv=False)[0] for W in source.weights])
    assert NetworkFeatures(source).lipschitz == pytest.approx(expected)


@pytest.mark.parametrize("features", [NetworkFeatures(channel(8)), radial()], ids=["network", "radial"])
def test_inputs_are_chosen_by_name_scaled_and_clipped(features):
    signals = np.zeros(SIGNAL_COUNT)
    signals[SIGNAL_INDEX["velocity_e"]] = 1e9
    signals[SIGNAL_INDEX["rate_r"]] = -1e9
    z = features.select(signals)
    assert z.shape == (5,)
    assert z[1] == INPUT_LIMIT
    assert z[4] == -INPUT_LIMIT
    both = features.select(np.stack([signals, np.zeros(SIGNAL_COUNT)], axis=1))
    np.testing.assert_array_equal(both[:, 0], z)
    Phi = features.evaluate(both)
    assert Phi.shape == (features.feature_count, 2)
    np.testing.assert_array_equal(Phi[-1], 1.0)
    assert np.abs(Phi).max() <= 1.0


def test_select_scales_by_offset_and_scale():
    source = channel(9)
    signals = np.arange(SIGNAL_COUNT, dtype=float) / 10.0
    expected = (signals[[SIGNAL_INDEX[name] for name in INPUTS]] - source.offset) / source.scale
    np.testing.assert_allclose(NetworkFeatures(source).select(signals), np.clip(expected, -3, 3))


def test_select_leaves_the_signals_alone():
    signals = np.full((SIGNAL_COUNT, 2), 50.0)
    radial().select(signals)
    np.testing.assert_array_equal(signals, 50.0)


def test_bias_features_have_no_inputs():
    features = BiasFeatures()
    z = features.select(np.zeros((SIGNAL_COUNT, 2)))
    np.testing.assert_array_equal(features.evaluate(z), [[1.0, 1.0]])
    assert features.lipschitz == 0.0


def test_halton_is_the_published_sequence():
    np.testing.assert_allclose(halton(4, 2), [[1 / 2, 1 / 3], [1 / 4, 2 / 3], [3 / 4, 1 / 9], [1 / 8, 4 / 9]])


def test_halton_refuses_what_it_has_no_primes_for():
    assert halton(3, 24).shape == (3, 24)
    with pytest.raises(ValueError, match="at most 24"):
        halton(3, 25)


def test_random_features_start_without_memory():
    start = random_channel(INPUTS, np.zeros(5), np.ones(5), (32, 32, 19), np.random.default_rng(0))
    np.testing.assert_array_equal(start.last_layer, 0.0)
    assert start.feature_count == 20
    again = random_channel(INPUTS, np.zeros(5), np.ones(5), (32, 32, 19), np.random.default_rng(0))
    np.testing.assert_array_equal(start.weights[1], again.weights[1])


def differences(features, signals, rows, step=1e-6):
    """dPhi/dx [k - 1, n] at the second column of the signals, by central differences."""
    columns = []
    for row in rows:
        moved = np.repeat(signals[:, 1:], 2, axis=1)
        moved[row] += [-step, step]
        Phi = features.evaluate(features.select(moved))
        columns.append((Phi[:-1, 1] - Phi[:-1, 0]) / (2.0 * step))
    return np.stack(columns, axis=1)


@pytest.mark.parametrize("kind", ["network", "one layer", "radial"])
@pytest.mark.parametrize("chosen", [[0, 1, 4], [3], [0, 1, 2, 3, 4]])
def test_the_slope_of_features_equals_differences(kind, chosen):
    rng = np.random.default_rng(5)
    source = channel(2, (19,) if kind == "one layer" else (32, 32, 19))
    features = NetworkFeatures(source)
    if kind == "radial":
        features = RadialFeatures(INPUTS, source.offset, source.scale, 0.6)
    rows = [SIGNAL_INDEX[name] for name in INPUTS]
    signals = np.zeros((SIGNAL_COUNT, 2))
    signals[rows] = source.offset[:, None] + source.scale[:, None] * rng.uniform(-1.0, 1.0, (5, 2))
    expected = differences(features, signals, [rows[i] for i in chosen])
    features.evaluate(features.select(signals))
    found = features.slope(1, np.array(chosen))
    assert found.shape == (features.feature_count - 1, len(chosen))
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("kind", ["network", "radial"])
def test_a_clipped_input_has_no_slope_and_leaves_that_of_the_others(kind):
    source = channel(3)
    features = NetworkFeatures(source)
    if kind == "radial":
        features = RadialFeatures(INPUTS, source.offset, source.scale, 2.0)
    z = np.full((5, 2), 0.3)
    features.evaluate(z)
    inside = features.slope(0, np.arange(5))
    z[1], z[2] = INPUT_LIMIT, -INPUT_LIMIT
    features.evaluate(z)
    clipped = features.slope(0, np.arange(5))
    assert np.abs(inside).max(axis=0).min() > 0.0
    np.testing.assert_array_equal(clipped[:, [1, 2]], 0.0)
    assert np.abs(clipped[:, [0, 3, 4]]).max(axis=0).min() > 0.0


def test_the_bias_alone_has_no_slope():
    assert BiasFeatures().slope(1, np.array([], dtype=np.intp)).shape == (0, 0)
