"""The adaptation laws: the C core against numpy's."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.c.library import Core
from onboard.control.laws.indi import Indi, IndiConfig
from onboard.control.laws.integral import Integral, IntegralConfig
from onboard.control.laws.l1 import L1, L1Config
from onboard.control.laws.last_layer import AdaptationConfig, LastLayer, lyapunov_p, tracking_weights
from onboard.control.laws.law import ChannelState
from onboard.control.laws.none import NoAugmentation, NoneConfig
from onboard.control.records import ChannelTelemetry
from onboard.control.reference_model import ChannelGains
from protocol.signals import SIGNAL_COUNT
from tests.onboard.c.parity import SETTINGS, array, call, configured, same, vectors, view
from tests.onboard.control.fixture import DT

GAINS = ChannelGains(natural_frequency_rad_s=(4.0, 5.0, 3.0), damping=0.8)
LAWS: dict[str, tuple[Any, Any]] = {
    "integral": (Integral, IntegralConfig(kind="integral", gain=(16.0, 10.0, 400.0), limit=2.0)),
    "indi": (Indi, IndiConfig(kind="indi", filter_s=0.05, limit=3.0)),
    "l1": (L1, L1Config(kind="l1", predictor_pole_rad_s=15.0, bandwidth_rad_s=9.0, limit=3.0)),
}
VALUES = ("tracking_error", "model_error", "rate", "u_hat", "residual")


def ticks(most: int = 6) -> st.SearchStrategy[Any]:
    """Some ticks of a channel: 21 numbers, whether it adapts and is saturated, the periods since the last one."""
    one = st.tuples(vectors(21, 5.0), st.booleans(), st.booleans(), st.sampled_from([1, 1, 1, 3]))
    return st.lists(one, min_size=1, max_size=most)


def state_of(tick: Any, seed: int = 0, states: int = 2) -> ChannelState:
    """states: 3 for a law that reads its map on the path."""
    values, adapt, saturated, periods = tick
    parts = np.split(np.array(values), [6, 12, 15, 18])
    signals = np.random.default_rng(seed).normal(size=(SIGNAL_COUNT, states))
    return ChannelState(periods * DT, adapt, saturated, **dict(zip(VALUES, parts, strict=True)), signals=signals)


def c_state(core: Core, state: ChannelState) -> Any:
    target = core.ChannelState()
    target.dt, target.adapt, target.saturated = state.dt, state.adapt, state.saturated
    for name in VALUES:
        view(getattr(target, name))[:] = getattr(state, name)
    target.lap_phase, target.lap_s = state.lap_phase, state.lap_s
    for name, column in zip(("signals", "signals_ahead", "signals_path"), state.signals.T, strict=False):
        view(getattr(target, name))[:] = column
    return target


def same_telemetry(ours: Any, theirs: ChannelTelemetry, rtol: float = 1e-12) -> None:
    for name in ("adaptive_now", "residual", "eps_1", "eps_2", "eps_3"):
        same(getattr(ours, name), getattr(theirs, name), rtol, scale=1.0)
    # The law with a covariance has it as a difference of squares: of W = 0 with a bias, the root of rounding.
    same(ours.weight_norm**2, theirs.weight_norm**2, rtol, scale=1.0)


@pytest.mark.parametrize("name", LAWS)
@SETTINGS
@given(given_ticks=ticks(), reset_after=st.integers(0, 6))
def test_laws_without_features(core: Core, name: str, given_ticks: Any, reset_after: int) -> None:
    law, config = LAWS[name]
    ours, theirs = getattr(core, type(config).__name__.removesuffix("Config"))(), law(config)
    getattr(core, f"{name}_init")(ours, configured(core, config))
    for index, tick in enumerate(given_ticks):
        state, telemetry, c_telemetry = state_of(tick), ChannelTelemetry(), core.ChannelTelemetry()
        expected = theirs.step(state, telemetry)
        nu = call(core, f"{name}_step", ours, c_state(core, state), c_telemetry, out=3)
        same(nu, expected, scale=1.0)
        same_telemetry(c_telemetry, telemetry)
        if index == reset_after:
            theirs.reset()
            getattr(core, f"{name}_reset")(ours)


def test_no_law(core: Core) -> None:
    expected = NoAugmentation(NoneConfig(kind="none")).step(ChannelState(), ChannelTelemetry())
    same(call(core, "none_step", out=3), expected)


# --- the last layer ---


def law_config(**values: Any) -> AdaptationConfig:
    given = {"tracking_gain": 6.0, "composite_gain": 17.0, "bias_weight": 70.0, "leak": 0.3, "weight_norm_max": 4.0}
    return AdaptationConfig(**{**given, **values})


def weights_of(gains: ChannelGains, error_weight: tuple[float, float]) -> Any:
    P = lyapunov_p(gains.closed_loop_matrix(), np.diag(np.repeat(error_weight, 3)))
    return tracking_weights(P, gains.natural_frequency_rad_s)


@SETTINGS
@given(
    omega=st.lists(st.floats(1.0, 30.0), min_size=3, max_size=3),
    zeta=st.floats(0.4, 2.0),
    q=st.lists(st.floats(0.01, 3.0), min_size=2, max_size=2),
)
def test_tracking_weights(core: Core, omega: list[float], zeta: float, q: list[float]) -> None:
    gains, ours = ChannelGains(natural_frequency_rad_s=(*omega,), damping=zeta), core.TrackingWeights()
    core.tracking_weights(configured(core, gains), array(core, q), ours)
    PB = weights_of(gains, (*q,))
    same(np.diag(view(ours.e_1)), PB[:3])
    same(np.diag(view(ours.e_2)), PB[3:])


@SETTINGS
@given(
    seed=st.integers(0, 2**31),
    size=st.sampled_from([0.1, 1.0, 5.0]),
    law=st.fixed_dictionaries(
        {
            "composite_gain": st.sampled_from([0.0, 17.0]),
            "leak": st.sampled_from([0.0, 0.3]),
            "weight_norm_max": st.sampled_from([2.0, 4.0, 100.0]),
        }
    ),
    errors=vectors(9, 3.0),
)
def test_last_layer(core: Core, seed: int, size: float, law: Any, errors: list[float]) -> None:
    rng, config = np.random.default_rng(seed), law_config(**law)
    PB, theirs = core.TrackingWeights(), LastLayer(config, 20, weights_of(GAINS, (1.0, 0.1)))
    ours = core.LastLayer()
    core.tracking_weights(configured(core, GAINS), array(core, (1.0, 0.1)), PB)
    core.last_layer_init(ours, configured(core, config), 20, PB)
    W, memory = size * rng.normal(size=(20, 3)), rng.normal(size=(20, 3))
    theirs.replace(W, memory)
    core.last_layer_replace(ours, array(core, W), array(core, memory), 20)
    for _ in range(3):
        Phi = np.append(np.tanh(rng.normal(size=19)), 1.0)
        theirs.step(Phi, np.array(errors[:6]), (*errors[6:],), DT)
        core.last_layer_step(ours, Phi, array(core, errors[:6]), array(core, errors[6:]), DT)
        same(view(ours.W)[:60], theirs.W)
        same(call(core, "last_layer_output", ours, Phi, out=3), Phi @ theirs.W, scale=1.0)
        assert core.last_layer_weight_norm(ours) == pytest.approx(theirs.weight_norm, rel=1e-12)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e200])
def test_a_step_that_is_not_finite_is_skipped(core: Core, bad: float) -> None:
    PB, ours = core.TrackingWeights(), core.LastLayer()
    core.tracking_weights(configured(core, GAINS), array(core, (1.0, 0.1)), PB)
    core.last_layer_init(ours, configured(core, law_config()), 4, PB)
    core.last_layer_replace(ours, np.arange(12.0) / 10.0, np.zeros(12), 4)
    before = view(ours.W).copy()
    core.last_layer_step(ours, np.ones(4), array(core, [bad, 0, 0, 0, 0, 0]), np.zeros(3), DT)
    core.last_layer_step(ours, array(core, [bad, 1, 1, 1]), np.ones(6), np.zeros(3), DT)
    np.testing.assert_array_equal(view(ours.W), before)
