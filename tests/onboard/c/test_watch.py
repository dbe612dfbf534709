"""The watch over one channel: the C core against numpy's, over whole sequences."""

from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from onboard.c.library import Core
from onboard.control.laws.law import ChannelState
from onboard.control.watch import ChannelWatch, WatchConfig
from tests.onboard.c.parity import SETTINGS, array, call, configured, same, view
from tests.onboard.c.test_laws import GAINS, c_state, weights_of
from tests.onboard.control.fixture import DT

FINDINGS = ("", "misfit", "misfit over its trial", "model error")
QUICK = {"lag_s": (0.05, 0.03), "misfit_floor": (0.3, 0.3), "error_floor": (0.3, 0.3), "worse_s": 0.1}
CONFIGS = [WatchConfig(), WatchConfig(**QUICK), WatchConfig(**QUICK, disagreement=(0.5, 0.5), average_s=0.3)]
LAWS = st.tuples(st.floats(0.0, 40.0), st.sampled_from([0.0, 5.0]))


class Both:
    """The two watches, side by side."""

    def __init__(self, core: Core, config: WatchConfig, channel: int, law: tuple[float, float]) -> None:
        self.core, self.ours, PB = core, core.ChannelWatch(), core.TrackingWeights()
        gains = configured(core, GAINS)
        core.tracking_weights(gains, array(core, (1.0, 0.1)), PB)
        core.watch_init(self.ours, configured(core, config), channel, gains, *law, PB)
        matrices = GAINS.stiffness(), GAINS.rate_gain()
        self.theirs = ChannelWatch(config, channel, matrices, law, weights_of(GAINS, (1.0, 0.1)))

    def step(self, state: ChannelState, vectors: Any, level: int) -> None:
        """One tick of both, and all that either knows. vectors: Delta_hat, nu now, nu commanded."""
        self.theirs.step(state, *vectors, level)
        self.core.watch_step(self.ours, c_state(self.core, state), *(array(self.core, one) for one in vectors), level)
        self.compare()

    def compare(self) -> None:
        ours, theirs, core = self.ours, self.theirs, self.core
        same(view(ours.d), theirs.d, scale=1.0)
        same(view(ours.misfits), theirs._misfits, scale=1.0)
        same(view(ours.errors), theirs._errors, scale=1.0)
        same([*view(ours.delta_1), *view(ours.delta_2)], [*theirs._delta[0], *theirs._delta[1]], scale=1.0)
        same([ours.worse_s, ours.evidence_s], [theirs._worse_s, theirs.evidence_s])
        same(ours.gain, theirs._gain, scale=1.0)
        same(view(ours.trial), theirs._trial, scale=1.0)
        same(call(core, "watch_numbers", ours, out=4), theirs.numbers, rtol=1e-9, scale=1.0)
        for one in (0, 1, 2):
            assert FINDINGS[core.watch_worse(ours, one, one + 1)] == theirs.worse(one, one + 1)
        assert core.watch_failed(ours) == theirs.failed
        for evidence_s in (0.1, 0.5):
            assert core.watch_stands(ours, evidence_s) == theirs.stands(evidence_s)
            assert core.watch_loses(ours, evidence_s) == theirs.loses(evidence_s)


def tick(rng: np.random.Generator, wrong: float, noise: float) -> tuple[ChannelState, Any]:
    """A tick in which the map is wrong by so much, with one to three periods since the last."""
    truth = 2.0 * np.sin(rng.normal(size=3))
    residual = truth + noise * rng.normal(size=3)
    signals = np.zeros((21, 2))
    state = ChannelState(DT * int(rng.choice([1, 1, 1, 3])), adapt=True, signals=signals, residual=residual)
    state.model_error[:] = noise * rng.normal(size=6)
    map_says = truth + wrong * rng.normal(size=3)
    return state, (residual, map_says, map_says + 0.1 * rng.normal(size=3))


@SETTINGS
@given(
    seed=st.integers(0, 2**31),
    config=st.sampled_from(CONFIGS),
    channel=st.integers(0, 1),
    law=LAWS,
    phases=st.lists(
        st.tuples(
            st.sampled_from(["go on", "restart", "reset"]),
            st.integers(0, 2),
            st.sampled_from([0.0, 1.0, 6.0]),
            st.sampled_from([0.0, 0.2, 2.0]),
            st.integers(1, 90),
        ),
        min_size=1,
        max_size=4,
    ),
)
def test_watch(core: Core, seed: int, config: WatchConfig, channel: int, law: Any, phases: Any) -> None:
    rng, both = np.random.default_rng(seed), Both(core, config, channel, law)
    for what, level, wrong, noise, ticks in phases:
        if what != "go on":
            getattr(both.theirs, what)()
            getattr(core, f"watch_{what}")(both.ours)
        for _ in range(ticks):
            both.step(*tick(rng, wrong, noise), level)


def test_all_findings_occur_in_both(core: Core) -> None:
    """Sequences that both call a misfit, a lost trial and a model error, and one that proves a map."""
    rng, found = np.random.default_rng(1), set()
    for config, wrong, error in (
        (CONFIGS[1], 6.0, 0.0),
        (WatchConfig(**{**QUICK, "misfit_floor": (900.0, 900.0), "trial_s": 0.5}), 6.0, 0.0),
        (WatchConfig(**{**QUICK, "misfit_floor": (900.0, 900.0), "trial_s": 30.0}), 0.0, 9.0),
    ):
        both = Both(core, config, 0, (10.0, 0.0))
        for _ in range(200):
            state, vectors = tick(rng, wrong, 0.0)
            state.model_error[:3] = error / GAINS.stiffness()  # what a nu wrong by `error` leads to
            both.step(state, (vectors[0], vectors[1] + error, vectors[2]), 0)
        assert both.theirs.failed
        found.add(both.theirs.worse(0, 1))
    assert found == {"misfit", "misfit over its trial", "model error"}
    both = Both(core, WatchConfig(), 0, (0.2, 0.0))  # a bias that is slow to learn what the map knows
    for _ in range(200):
        state, (residual, _, _) = tick(rng, 0.0, 0.0)
        residual[:] = 3.0
        both.step(state, (residual, residual, residual), 0)
    assert both.theirs.stands(0.5)


def test_a_lag_longer_than_the_ring_holds_takes_the_oldest_early(core: Core) -> None:
    """Ticks shorter than a configuration allows: the ring stays within its limit."""
    both = Both(core, WatchConfig(lag_s=(1.0, 1.0)), 0, (10.0, 0.0))
    state, ones = ChannelState(dt=1e-5, adapt=True, signals=np.zeros((21, 2))), array(core, [1.0] * 3)
    for _ in range(4 * 300):
        core.watch_step(both.ours, c_state(core, state), ones, ones, ones, 0)
    assert both.ours.sent_count == 255
    assert both.ours.misfits[2] > 0.0
