"""Features, last layer and swap together, with both laws: the C core against numpy's."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from configs.parts import part_names, read_part
from onboard.c.library import Core
from onboard.control.features import NetworkFeatures
from onboard.control.laws import slope_bound
from onboard.control.laws.adaptive import AdaptiveAugmentation, AdaptiveConfig
from onboard.control.laws.kalman_last_layer import KalmanConfig
from onboard.control.laws.kalman_state import KalmanState
from onboard.control.laws.law import ChannelState
from onboard.control.laws.slope_bound import bound_slopes
from onboard.control.records import ChannelTelemetry
from onboard.control.slope import SlopeLimits, SlopeShares
from protocol.feature_set import ChannelFeatures
from protocol.messages import REFUSALS
from protocol.signals import SIGNAL_COUNT
from tests.onboard.c.channels import c_channel, c_network_features, channel
from tests.onboard.c.parity import SANITIZED, SETTINGS, array, call, configured, same, view
from tests.onboard.c.test_kalman import covariance, kalman_config
from tests.onboard.c.test_laws import GAINS, c_state, law_config, same_telemetry, state_of, ticks
from tests.onboard.control.fixture import DT, FEATURES

LAWS = {
    "gradient": law_config(),
    "covariance": kalman_config(slope=SlopeShares(place=0.1, motion=0.02, turn=0.02)),
    "flattened": kalman_config(slope=SlopeShares(place=0.005, motion=0.001, turn=0.001)),
    "off": kalman_config(composite_gain=0.0, tracking_gain=0.0),
    "on the ball": kalman_config(weight_norm_max=2.0, prior=2.0, confidence=False),
}
SEEDS = st.integers(0, 2**31)


def shipped_laws() -> list[KalmanConfig]:
    """The laws with a covariance of all shipped controllers."""
    found = []
    for name in part_names("controllers"):
        for side in ("position", "attitude"):
            law = read_part("controllers", name)["settings"].get(side, {}).get("augmentation", {}).get("law", {})
            if law.get("kind") == "kalman":
                found.append(KalmanConfig(**law))
    assert found
    return found


def adaptive_config(kind: str, law: str = "covariance", **swap: Any) -> AdaptiveConfig:
    swapping = {"jump_max": 30.0, "ring_size": 8, "ring_period_ticks": 2, **swap}
    return AdaptiveConfig(kind="adaptive", features=kind, law=LAWS[law], swap=swapping)  # type: ignore[arg-type]


def start(core: Core, config: AdaptiveConfig, seed: int) -> Any:
    """C's Adaptive of the position channel, with the slopes that its law allows."""
    ours, gains, limits, c_config = (
        core.Adaptive(),
        configured(core, GAINS),
        core.SlopeLimits(),
        configured(core, config),
    )
    core.slope_limits_of(0, gains, gains, configured(core, config.slope_shares), limits)
    if config.features == "network":
        ours.features = c_network_features(core, channel(seed))
    else:
        core.features_init_bias(ours.features)
    core.adaptive_init(ours, c_config, gains, limits)
    return ours


def states_of(theirs: AdaptiveAugmentation) -> int:
    """How many states the law sees."""
    return 3 if theirs.reads_path else 2


def both(core: Core, config: AdaptiveConfig, seed: int) -> tuple[Any, AdaptiveAugmentation]:
    rng, limits = np.random.default_rng(seed), SlopeLimits.of("position", GAINS, GAINS, config.slope_shares)
    theirs = AdaptiveAugmentation(config, GAINS, FEATURES.untrained, "position", rng, limits)
    if config.features == "network":
        theirs._use(NetworkFeatures(channel(seed)))
    ours = start(core, config, seed)
    same(np.diag(view(ours.tracking_weights.e_2)), theirs.tracking_weights[3:])
    assert core.adaptive_learns(ours) == theirs.learns
    assert core.adaptive_reads_path(ours) == theirs.reads_path
    law = theirs.last_layer.config
    rates = core.adaptive_composite_gain(ours), core.adaptive_tracking_gain(ours), core.adaptive_jump_max(ours)
    assert rates == (law.composite_gain, law.tracking_gain, theirs.jump_max)
    return ours, theirs


def step_both(core: Core, ours: Any, theirs: AdaptiveAugmentation, state: ChannelState, rtol: float = 1e-11) -> None:
    telemetry, c_telemetry = ChannelTelemetry(), core.ChannelTelemetry()
    expected = theirs.step(state, telemetry)
    nu = call(core, "adaptive_step", ours, c_state(core, state), c_telemetry, out=3)
    same(nu, expected, rtol, scale=1.0)
    same_telemetry(c_telemetry, telemetry, rtol)


def same_learnt(core: Core, ours: Any, theirs: AdaptiveAugmentation, rtol: float) -> None:
    k = theirs.features.feature_count
    one, other, W = core.Learnt(), theirs.learnt(), np.empty((k, 3))
    core.adaptive_learnt(ours, one)
    core.adaptive_W(ours, W)
    assert one.features.feature_count == k
    same(W, theirs.last_layer.W, rtol, scale=1.0)
    same(view(one.theta)[: 3 * k], other.theta, rtol, scale=1.0)
    same(view(one.W)[: other.W.size], other.W, rtol, scale=1.0)
    if other.S is not None:
        same(view(one.S)[: other.S.size], other.S, rtol)
    prior = np.ctypeslib.as_array(core.adaptive_prior_layer(ours), (k, 3))
    same(prior, theirs.prior_layer, rtol, scale=1.0)


@SETTINGS
@given(
    given_ticks=ticks(5),
    seed=SEEDS,
    kind=st.sampled_from(["network", "bias"]),
    law=st.sampled_from(["gradient", "covariance", "off"]),
)
def test_adaptive(core: Core, given_ticks: Any, seed: int, kind: str, law: str) -> None:
    ours, theirs = both(core, adaptive_config(kind, law), seed)
    for index, tick in enumerate(given_ticks):
        step_both(core, ours, theirs, state_of(tick, seed + index, states_of(theirs)))
    theirs.reset()
    core.adaptive_reset(ours)
    step_both(core, ours, theirs, state_of(given_ticks[0], seed, states_of(theirs)))
    same_learnt(core, ours, theirs, 1e-11)


# --- swaps ---


def planned(core: Core, ours: Any, offered: Any) -> tuple[Any, Any]:
    """The new features and the plan of C, all parts at once."""
    plan, swap, law = core.SwapPlan(), core.PosteriorSwap(), ours.kalman_layer
    if not core.adaptive_prepare(ours, offered, swap):
        new, work = core.Features(), core.SwapWorkspace()
        core.adaptive_plan(ours, offered, new, work, plan)
        return new, plan
    while not core.posterior_swap_step(swap, ours.config.swap, law, ours.slope_limits):
        pass
    core.adaptive_planned(ours, swap, plan)
    return swap.features, plan


def plan_both(core: Core, ours: Any, theirs: AdaptiveAugmentation, offered: ChannelFeatures) -> str:
    """Plan a swap in both, carry it out if it is not refused; returns the refusal."""
    new, plan = theirs.plan(offered)
    c_offered = c_channel(core, offered)
    c_new, c_plan = planned(core, ours, c_offered)
    assert REFUSALS[c_plan.refusal] == plan.refusal
    same(view(c_plan.W)[: plan.W.size], plan.W, rtol=1e-9, scale=1.0)
    same(view(c_plan.theta)[: plan.W.size], plan.theta, rtol=1e-11, scale=1.0)
    same([c_plan.jump, c_plan.step], [plan.jump, plan.step], rtol=1e-9, scale=1.0)
    prior = np.ctypeslib.as_array(core.adaptive_prior_of(ours, c_plan), plan.W.shape)
    same(prior, theirs.prior_of(plan), rtol=1e-9, scale=1.0)
    if not plan.refusal:
        theirs.commit(new, plan)
        core.adaptive_commit(ours, c_new, c_plan)
        same_learnt(core, ours, theirs, 1e-9)
        assert core.adaptive_flies(ours, c_offered)
        assert theirs.flies(offered)
    return plan.refusal


def path_state(tick: int, rng: np.random.Generator, states: int, adapt: bool = True, periods: int = 1) -> ChannelState:
    """A tick along a path on which the signals move together, and a residual that they explain in part.

    The vehicle is late on the path.
    """
    state = ChannelState(periods * DT, adapt, signals=np.zeros((SIGNAL_COUNT, states)))
    rows = np.arange(SIGNAL_COUNT)
    for column, t in enumerate((tick * DT, tick * DT + 0.15, tick * DT + 0.03)[:states]):
        state.signals[:, column] = np.sin((0.5 + 0.2 * rows) * t + rows)
    state.residual[:] = 2.0 * state.signals[:3, 0] + 0.3 * rng.normal(size=3)
    state.model_error[:] = 0.05 * rng.normal(size=6)
    return state


@SETTINGS
@given(
    seed=SEEDS,
    law=st.sampled_from(list(LAWS)),
    naive=st.booleans(),
    size=st.sampled_from([0.05, 1.0]),
    period=st.sampled_from([1, 5]),
)
def test_a_flight_with_swaps(core: Core, seed: int, law: str, naive: bool, size: float, period: int) -> None:
    """Some hundred ticks with swaps, refused or not, ticks that do not adapt, missed ones, and W that is taken back."""
    limits = {"naive": naive, "jump_max": 2.0, "ring_size": 40, "ring_period_ticks": period}
    ours, theirs = both(core, adaptive_config("network", law, **limits), seed)
    rng, kept, c_kept = np.random.default_rng(seed), theirs.learnt(), core.Learnt()
    core.adaptive_learnt(ours, c_kept)
    rtol = 1e-11
    for tick in range(130 if SANITIZED else 330):
        missed = tick % 60 == 17 or tick % 94 == 49  # the latter before a swap, some in a tick that does not adapt
        state = path_state(tick, rng, states_of(theirs), tick % 50 < 46, 3 if missed else 1)
        step_both(core, ours, theirs, state, rtol)
        if tick % 47 == 2:
            widths = (8, 12) if tick % 3 == 0 else (16, 19)
            offered = channel(seed + tick, widths, gain=0.7)
            plan_both(core, ours, theirs, dataclasses.replace(offered, last_layer=size * offered.last_layer))
            rtol = 1e-9
        if tick % 90 == 60:
            nu = 3.0 * rng.normal(size=3)
            theirs.restore(kept, tuple(nu.tolist()))
            core.adaptive_restore(ours, c_kept, nu)
            same_learnt(core, ours, theirs, rtol)
        if tick % 90 == 40:
            kept = theirs.learnt()
            core.adaptive_learnt(ours, c_kept)
    states, residuals = np.empty((200, SIGNAL_COUNT)), np.empty((200, 3))
    n = core.adaptive_recent(ours, states, residuals)
    in_order, measured = theirs.recent
    np.testing.assert_array_equal(states[:n], in_order.T)
    same(residuals[:n], measured, 1e-12)


def test_what_these_swaps_reach(core: Core) -> None:
    """Accepted ones and each refusal of a plan."""
    found = set()
    for law, size, limits in (
        ("covariance", 0.1, {}),
        ("covariance", 1.0, {"jump_max": 0.01}),
        ("covariance", 20.0, {}),
        ("covariance", 0.1, {"lipschitz_max": 0.01}),
    ):
        ours, theirs = both(core, adaptive_config("network", law, **limits), 4)
        rng = np.random.default_rng(4)
        for tick in range(20):
            step_both(core, ours, theirs, path_state(tick, rng, states_of(theirs)))
        offered = channel(5)
        found.add(plan_both(core, ours, theirs, dataclasses.replace(offered, last_layer=size * offered.last_layer)))
    assert found == {"", "swap_jump", "weight_norm", "lipschitz"}


def test_what_the_bound_of_the_slope_reaches(core: Core, monkeypatch: pytest.MonkeyPatch) -> None:
    """In flights as above it changes the weights in some checks, and in others it does not."""
    changed = []

    def watched(state: KalmanState, *given: Any) -> None:
        before = state.X_rows.copy()
        bound_slopes(state, *given)
        changed.append(bool((state.X_rows != before).any()))

    monkeypatch.setattr(slope_bound, "bound_slopes", watched)
    ours, theirs = both(core, adaptive_config("network", "flattened"), 7)
    rng = np.random.default_rng(7)
    for tick in range(60):
        step_both(core, ours, theirs, path_state(tick, rng, states_of(theirs), tick % 20 < 17), 1e-10)
    assert len(changed) == 13
    assert set(changed) == {True, False}
    same_learnt(core, ours, theirs, 1e-10)


def test_a_swap_before_the_first_tick_and_one_after_numbers_that_are_not_finite(core: Core) -> None:
    for law in ("covariance", "gradient"):
        ours, theirs = both(core, adaptive_config("network", law, jump_max=1e9), 1)
        small = dataclasses.replace(channel(2), last_layer=0.1 * channel(2).last_layer)
        assert plan_both(core, ours, theirs, small) == ""
    ours, theirs = both(core, adaptive_config("network", jump_max=1e9), 1)
    theirs._recent.push(np.full(SIGNAL_COUNT, np.nan))
    core.recent_push(ours.recent, np.full(SIGNAL_COUNT, np.nan), np.zeros(3))
    _, plan = planned(core, ours, c_channel(core, small))
    assert REFUSALS[plan.refusal] == theirs.plan(small)[1].refusal == "not_finite"


def test_features_that_fly_already(core: Core) -> None:
    """To the bit, the trained last layer as well, although a steep one flies flattened."""
    ours, theirs = both(core, adaptive_config("network", jump_max=1e9), 3)
    rng = np.random.default_rng(3)
    for tick in range(30):
        step_both(core, ours, theirs, path_state(tick, rng, states_of(theirs)))
    offered = channel(4)
    assert (core.adaptive_flies(ours, c_channel(core, offered)), theirs.flies(offered)) == (False, False)
    assert plan_both(core, ours, theirs, offered) == ""
    assert np.abs(theirs.prior_layer - offered.last_layer).max() > 0.1  # flattened
    for other in (c_channel(core, channel(5)), _changed(c_channel(core, offered), "last_layer", 4)):
        assert not core.adaptive_flies(ours, other)


def _changed(offered: Any, name: str, index: int) -> Any:
    getattr(offered, name)[index] += 1e-9
    return offered


@pytest.mark.parametrize("law", ["gradient", "covariance"])
def test_w_of_an_earlier_flight(core: Core, law: str) -> None:
    ours, theirs = both(core, adaptive_config("network", law), 6)
    W = np.random.default_rng(6).normal(size=(20, 3))
    theirs.last_layer.replace(W, W)
    core.adaptive_start_from(ours, array(core, W))
    same_learnt(core, ours, theirs, 1e-12)
    step_both(core, ours, theirs, path_state(0, np.random.default_rng(1), states_of(theirs)))


@pytest.mark.parametrize("law", [LAWS["covariance"], *shipped_laws()])
def test_s_stays_symmetric_and_positive_definite_over_swaps_in_float(core32: Core, law: KalmanConfig) -> None:
    """The posterior is found by the filter, in float, from S0 on: after each swap, and 100 ticks later."""
    config = adaptive_config("network", jump_max=1e9, ring_size=40, ring_period_ticks=5)
    config = config.model_copy(update={"law": law})
    ours = start(core32, config, 1)
    rng = np.random.default_rng(2)
    for tick in range(400):
        state = c_state(core32, path_state(tick, rng, 3))
        core32.adaptive_step(ours, state, core32.ChannelTelemetry(), np.empty(3, np.float32))
        if tick % 100 == 99:
            same_definite(ours.kalman_layer.state)
            offered = channel(tick)
            offered = dataclasses.replace(offered, last_layer=0.1 * offered.last_layer)
            new, plan = planned(core32, ours, c_channel(core32, offered))
            assert REFUSALS[plan.refusal] == ""
            core32.adaptive_commit(ours, new, plan)
            same_definite(ours.kalman_layer.state)


def same_definite(state: Any) -> None:
    S = covariance(state).astype(np.float64)
    np.testing.assert_array_equal(S, S.T)
    assert np.linalg.eigvalsh(S)[0] > 1e-4
