"""The networks: numpy compared with torch, the spectral bound, and the form that is sent."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from offboard.training.gradient import LossGradient, Views, layer_outputs, parameters_of
from offboard.training.network import (
    InputPlan,
    channel_features,
    feature_set,
    initial_state,
    phi,
    scales_from_data,
    state_of,
)
from offboard.training.spectral_bound import SpectralBound
from protocol.feature_config import TrainedFeatures
from protocol.signals import SIGNAL_COUNT, SIGNAL_INDEX
from tests.offboard.flights import figure8_through_jet, offboard_config

CONFIG = offboard_config().features.trained
BOUND = CONFIG.spectral_norm_max


def signals(n: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    scales = np.array([CONFIG.scales[name].scale for name in SIGNAL_INDEX])
    offsets = np.array([CONFIG.scales[name].offset for name in SIGNAL_INDEX])
    return (offsets + scales * rng.normal(0.0, 1.0, (n, SIGNAL_COUNT))).astype(np.float32)


@pytest.mark.parametrize("channels", [("position", "attitude"), ("attitude",), ("position",)])
def test_numpy_features_equal_torchs(channels: tuple[str, ...]) -> None:
    config = CONFIG.model_copy(update={"channels": channels})
    plan, state = InputPlan.of(config), initial_state(config, np.random.default_rng(4))
    x = signals(200)
    z = torch.from_numpy(plan.gather(x, state.offset, state.scale))
    by_torch = layer_outputs(z, parameters_of(state))[-1].numpy()
    for row in range(len(channels)):
        Phi = phi(channel_features(state, plan, row), x)
        assert Phi.shape == (200, config.count)
        assert np.array_equal(Phi[:, -1], np.ones(200))
        assert np.abs(Phi[:, :-1] - by_torch[row].T).max() < 2e-6


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**31), spread=st.floats(1e-3, 10.0))
def test_lipschitz_bound_holds_on_random_pairs(seed: int, spread: float) -> None:
    rng = np.random.default_rng(seed)
    state = initial_state(CONFIG, rng)
    grown = parameters_of(state)
    grown.flat.mul_(float(rng.uniform(1.0, 20.0)))
    SpectralBound(grown.weights, BOUND).exact()
    for row in range(len(CONFIG.channels)):
        weights = [W[row].numpy().astype(np.float64) for W in grown.weights]
        limit = float(np.prod([np.linalg.norm(W, 2) for W in weights]))
        assert all(np.linalg.norm(W, 2) <= BOUND for W in weights)
        z = torch.from_numpy(
            rng.normal(0.0, spread, (len(CONFIG.channels), weights[0].shape[0], 64)).astype(np.float32)
        )
        features = layer_outputs(z, grown)[-1][row].double().numpy()
        apart = np.linalg.norm(z[row].double().numpy()[:, :32] - z[row].double().numpy()[:, 32:], axis=0)
        moved = np.linalg.norm(features[:, :32] - features[:, 32:], axis=0)
        assert (moved <= limit * apart + 1e-5).all()
        assert limit <= BOUND ** len(weights)


def test_power_iteration_keeps_the_norm_close_to_the_bound_while_weights_move() -> None:
    rng = np.random.default_rng(3)
    parameters = parameters_of(initial_state(CONFIG, rng))
    bound = SpectralBound(parameters.weights, BOUND)
    for _ in range(60):
        for W in parameters.weights:
            W.add_(torch.from_numpy(rng.normal(0.0, 0.02, W.shape).astype(np.float32)))
        bound.approximate()
    worst = max(float(np.linalg.norm(W.numpy(), 2, axis=(1, 2)).max()) for W in parameters.weights)
    assert worst < 1.15 * BOUND
    without = SpectralBound(parameters.weights, 1e6)
    for W in parameters.weights:
        W.mul_(3.0)
    without.approximate()
    assert max(float(np.linalg.norm(W.numpy(), 2, axis=(1, 2)).max()) for W in parameters.weights) > BOUND


@pytest.mark.parametrize("dropout", [False, True])
def test_the_written_out_gradient_equals_autograd(dropout: bool) -> None:
    rng = np.random.default_rng(8)
    state = initial_state(CONFIG, rng)
    C, m, k = len(CONFIG.channels), state.weights[0].shape[1], CONFIG.count
    flat = (
        parameters_of(state).flat
        + 0.1 * torch.from_numpy(rng.normal(size=4096 * 4).astype(np.float32))[: parameters_of(state).flat.numel()]
    )
    z = torch.from_numpy(rng.normal(size=(C, m, 64)).astype(np.float32))
    y = torch.from_numpy(rng.normal(size=(C, 3, 64)).astype(np.float32))
    kept = torch.from_numpy((rng.random((C, k - 1, 64)) > 0.3).astype(np.float32)) if dropout else None
    gradient = Views.of(torch.zeros_like(flat), state)
    errors = LossGradient(Views.of(flat, state), gradient, 64).at(z, y, None, kept)
    leaf = flat.clone().requires_grad_(True)
    views = Views.of(leaf, state)
    h = z.mT  # one row per sample
    for W, b in zip(views.weights, views.biases, strict=True):
        h = torch.tanh(torch.baddbmm(b, h, W))
    h = h if kept is None else h * kept.mT
    loss = (torch.baddbmm(views.last_bias, h, views.last_layer) - y.mT).square().mean()
    loss.backward()  # type: ignore[no-untyped-call]
    assert leaf.grad is not None
    assert float(errors.square().mean()) == pytest.approx(float(loss.detach()), rel=1e-5)
    assert torch.allclose(gradient.flat, leaf.grad, atol=1e-6, rtol=1e-4)


def test_a_version_can_be_trained_further_exactly() -> None:
    plan, state = InputPlan.of(CONFIG), initial_state(CONFIG, np.random.default_rng(2))
    again = state_of(feature_set(state, plan, 3, 2, 10), CONFIG)
    for first, second in zip((*state.weights, *state.biases), (*again.weights, *again.biases), strict=True):
        assert np.array_equal(first, second)


def test_a_version_with_other_inputs_or_widths_is_refused() -> None:
    plan, state = InputPlan.of(CONFIG), initial_state(CONFIG, np.random.default_rng(2))
    version = feature_set(state, plan, 3, 2, 10)
    narrow = CONFIG.model_copy(update={"hidden": (16, 16)})
    blind = CONFIG.model_copy(update={"position_inputs": ("position_n",)})
    for other, why in ((narrow, "widths"), (blind, "inputs")):
        with pytest.raises(ValueError, match=why):
            state_of(version, other)


def test_scales_from_data_are_never_tiny() -> None:
    x = signals(50)
    x[:, SIGNAL_INDEX["position_n"]] = 4.0  # hovering: no spread
    offset, scale = scales_from_data(CONFIG, x)
    assert offset[0, 0] == pytest.approx(4.0)
    assert scale[0, 0] == pytest.approx(0.5 * CONFIG.scales["position_n"].scale)


def test_unknown_or_missing_signals_are_named() -> None:
    tree = CONFIG.model_dump()
    tree["scales"].pop("roll")
    with pytest.raises(ValueError, match="roll"):
        TrainedFeatures.model_validate(tree)
    with pytest.raises(ValueError, match="altitude"):
        TrainedFeatures.model_validate({**CONFIG.model_dump(), "position_inputs": ("altitude",)})


def test_the_artificial_flight_is_consistent() -> None:
    """The artificial flight obeys v_dot = u_hat + Delta, which all other tests assume."""
    flight = figure8_through_jet(4.0, noise=0.0, gust_m_s2=0.0)
    columns = [SIGNAL_INDEX[f"velocity_{axis}"] for axis in "ned"]
    gained = np.diff(flight.signals[:, columns], axis=0) / 0.02
    mean_delta = gained - flight.delivered[1:, 0]
    assert np.abs(mean_delta - 0.5 * (flight.delta[1:, 0] + flight.delta[:-1, 0])).max() < 0.15
