"""The guard: the C core against numpy's, over whole sequences of versions, good and bad."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.c.feature_arrays import put_feature_set
from onboard.c.library import Core
from onboard.control.guard import Level, content_of
from protocol.feature_set import ChannelFeatures, FeatureSet
from protocol.messages import REFUSALS
from protocol.signals import SIGNAL_INDEX
from tests.onboard.c.guarded_pair import SIZES, Pair, smooth_channel
from tests.onboard.c.parity import SANITIZED, SETTINGS, view
from tests.onboard.control.test_guard import cliff

LONG = settings(SETTINGS, max_examples=4 if SANITIZED else 10)
FEATURED = ["gradient", "covariance"]
OFFERS = ("true", "wrong", "flat", "steep", "high", "other", "again", "same", "position", "attitude")


def made(pair: Pair, kind: str, number: int) -> tuple[ChannelFeatures, ChannelFeatures]:
    """Both channels of a version of this kind: theta against the truth of the world."""
    factors = {"true": 1.0, "wrong": -1.0, "flat": 0.0, "high": 40.0}
    if kind == "other":
        position, attitude = (smooth_channel(side, 1000 + number, 0.5 * SIZES[side]) for side in (0, 1))
    elif kind == "steep":
        position, attitude = (
            dataclasses.replace(one, weights=tuple(6.0 * W for W in one.weights)) for one in pair.world.truth
        )
    else:
        factor = factors.get(kind, 1.0) * (1.0 + 1e-3 * number)  # another content each time
        position, attitude = (dataclasses.replace(one, last_layer=factor * one.last_layer) for one in pair.world.truth)
    return position, attitude


class Trainer:
    """Numbers versions and remembers what it has sent."""

    def __init__(self, pair: Pair) -> None:
        self._pair, self._number, self.sent = pair, 0, list[FeatureSet]()

    def offer(self, kind: str) -> str:
        self._number += 1
        if kind in ("again", "same") and self.sent:
            old = self.sent[-1] if kind == "same" else self.sent[self._number % len(self.sent)]
            features = dataclasses.replace(old, version=self._number)
        else:
            position, attitude = made(self._pair, kind, self._number)
            one, other = kind != "attitude", kind != "position"
            features = FeatureSet(self._number, 0, 100, position if one else None, attitude if other else None)
        self.sent.append(features)
        return self._pair.offer(features)


TOUCHY = {
    "misfit_floor": (0.15, 1.5),
    "error_floor": (0.1, 1.0),
    "margin": 1.05,
    "worse_s": 0.1,
    "proof_s": 0.2,
    "audition_s": 0.1,
    "agreement_s": 0.2,
}
"""A watch that takes a law back for little, and believes in one for little."""
GUARDS = st.fixed_dictionaries(
    {
        "room": st.fixed_dictionaries({"enabled": st.booleans(), "share": st.just((0.3, 0.3))}),
        "test": st.fixed_dictionaries({"enabled": st.booleans()}),
        "watch": st.sampled_from([TOUCHY, TOUCHY, TOUCHY, {}, {"enabled": False}]),
        "swaps_per_s_max": st.sampled_from([1.0, 4.0]),
        "strikes_max": st.sampled_from([1, 2, 3]),
        "losses_max": st.sampled_from([1, 2, 3]),
        "jumps_max": st.sampled_from([0.5, 50.0]),
    }
)
PHASES = st.lists(
    st.tuples(
        st.sampled_from(OFFERS),
        st.sampled_from([1.0, 1.0, -2.0, 0.3]),
        st.sampled_from([0.0, 0.0, 4.0]),
        st.sampled_from(["fly", "fly", "fly", "no adapt", "ground", "demand"]),
        st.integers(10, 100),
    ),
    min_size=2,
    max_size=5,
)


def fly(pair: Pair, ticks: int, how: str = "fly") -> None:
    """So many ticks; some come late."""
    if how == "ground":
        pair.reset()
    for tick in range(ticks):
        demand = 3.0 * np.sin(0.1 * tick) if how == "demand" else 0.0
        pair.step(
            how not in ("no adapt", "ground"), 3 if tick % 37 == 11 else 1, demand, 0.2 if how == "demand" else 0.6
        )


@pytest.mark.parametrize("law", [*FEATURED, "attitude alone"])
@LONG
@given(seed=st.integers(0, 2**31), guard=GUARDS, phases=PHASES)
def test_any_flight(core: Core, law: str, seed: int, guard: Any, phases: Any) -> None:
    """Versions of all kinds, a disturbance that changes, ticks that do not adapt, landings, a need for the room."""
    pair = Pair(core, law, guard, seed)
    trainer = Trainer(pair)
    fly(pair, 40)
    for kind, mood, push, how, ticks in phases:
        trainer.offer(kind)
        pair.world.mood, pair.world.push = mood, push
        fly(pair, ticks, how)


def test_without_learnt_features_nothing_is_guarded(core: Core) -> None:
    pair = Pair(core, "without features", {})
    fly(pair, 20)
    assert Trainer(pair).offer("true") == "not_accepting"
    pair.reset()
    fly(pair, 5, "demand")
    assert not any(pair.theirs.limited)


# --- what a flight must contain, so that the test above compares something ---

FREE: dict[str, Any] = {
    "test": {"enabled": False},
    "room": {"enabled": False},
    "watch": TOUCHY,
    "jumps_max": 1e3,
    "swaps_per_s_max": 100.0,
}


def until(pair: Pair, done: Callable[[], bool], ticks: int = 500) -> None:
    """Fly until this is so."""
    for _ in range(ticks):
        if done():
            return
        fly(pair, 1)
    raise AssertionError(f"not within {ticks} ticks: {pair.texts}")


@pytest.mark.parametrize("law", FEATURED)
def test_back_to_the_good_version_to_the_bias_to_none_and_up_again(core: Core, law: str) -> None:
    """With all that is refused on the way."""
    patient = {**TOUCHY, "error_floor": (0.6, 6.0), "misfit_floor": (0.3, 3.0)}
    pair = Pair(core, law, {**FREE, "watch": patient, "strikes_max": 1})
    trainer, guard, world = Trainer(pair), pair.theirs, pair.world
    fly(pair, 60)
    assert trainer.offer("true") == ""
    until(pair, lambda: guard._proven)
    assert guard.version == 1
    assert trainer.offer("other") == ""
    world.mood = -2.0
    until(pair, lambda: guard.version == 1)
    assert "version 2 taken back, version 1 flies" in pair.texts[-1]
    assert (trainer.offer("same"), trainer.offer("flat")) == ("taken_back", "not_trusted")
    world.push = 6.0
    until(pair, lambda: guard.level is Level.BIAS)
    until(pair, lambda: guard.level is Level.NONE)
    world.mood, world.push = 1.0, 0.0
    fly(pair, 20, "ground")
    assert guard.level is Level.BIAS
    fly(pair, 100)


@pytest.mark.parametrize("law", FEATURED)
def test_a_version_from_the_ground_flies_after_its_audition(core: Core, law: str) -> None:
    pair = Pair(core, law, {**FREE, "watch": {**TOUCHY, "misfit_floor": (9.0, 90.0), "error_floor": (9.0, 90.0)}})
    trainer = Trainer(pair)
    fly(pair, 30, "ground")
    assert trainer.offer("true") == ""
    assert pair.theirs.level is Level.BIAS
    fly(pair, 400)
    assert pair.texts == ["guard: version 1 flies after its audition"]


@pytest.mark.parametrize("law", FEATURED)
def test_a_version_that_agrees_with_the_bias_flies_without_evidence(core: Core, law: str) -> None:
    pair = Pair(core, law, {**FREE, "watch": {"disagreement": (90.0, 900.0), "agreement_s": 0.5}})
    fly(pair, 30, "ground")
    assert Trainer(pair).offer("true") == ""
    fly(pair, 300)
    assert pair.texts == ["guard: version 1 flies after its audition"]
    assert pair.theirs._watches[0].evidence_s == 0.0


@pytest.mark.parametrize("law", FEATURED)
def test_a_cliff_that_comes_into_reach(core: Core, law: str) -> None:
    """It is far away when the version comes."""
    floors = {"misfit_floor": (90.0, 900.0)}
    pair = Pair(core, law, {"watch": {**floors, "error_floor": (90.0, 900.0)}, "test": floors})
    world = pair.world
    fly(pair, 60)
    while world.signals_at(world.time_s)[SIGNAL_INDEX["position_n"]] > -0.9:
        fly(pair, 1)
    source = cliff(0.8, 150.0, 9.0)
    assert pair.offer(FeatureSet(1, 0, 5, source, None)) == ""
    fly(pair, 300)
    assert pair.texts == ["guard: steep or high ahead in position: version 1 taken back, version 0 flies"]


def test_a_busy_tick_leaves_out_its_part_of_the_check_but_never_four_in_a_row(core: Core) -> None:
    floors = {"misfit_floor": (90.0, 900.0)}
    pair = Pair(core, "gradient", {"watch": {**floors, "error_floor": (90.0, 900.0)}, "test": floors})
    fly(pair, 60)
    assert Trainer(pair).offer("true") == ""
    fly(pair, 100)
    seen = []
    for _ in range(40):
        core.guard_judge(pair.ours, pair.c_laws[0], 0.005, True, True)
        seen.append(tuple(test.look.seen for test in pair.ours.tests))
    moved = [index for index in range(1, 40) if seen[index] != seen[index - 1]]
    assert np.diff(moved).tolist() == [4] * (len(moved) - 1)
    assert len(moved) > 7


@pytest.mark.parametrize("law", FEATURED)
def test_a_version_that_loses_when_the_next_one_comes(core: Core, law: str) -> None:
    quiet = {"misfit_floor": (90.0, 900.0), "error_floor": (90.0, 900.0), "disagreement": (0.01, 0.01), "trial_s": 30.0}
    pair = Pair(core, law, {**FREE, "watch": quiet, "losses_max": 1})
    trainer = Trainer(pair)
    fly(pair, 60)
    assert trainer.offer("wrong") == ""
    fly(pair, 200)
    assert trainer.offer("true") == ""
    assert pair.texts == ["guard: misfit of the version before: version 1 taken back, version 0 flies"]
    assert pair.theirs.version == 2
    assert pair.theirs.level is Level.BIAS, "it needs evidence first"
    fly(pair, 50)


@pytest.mark.parametrize("law", FEATURED)
def test_every_refusal(core: Core, law: str) -> None:
    """But those of the content (test_transfer.py) and after a fall (above)."""
    found = set()
    for guard, kinds in (
        ({"test": {"misfit": 0.01, "misfit_floor": (0.01, 0.01)}}, ("wrong",)),
        ({"test": {"spread_max": (0.01, 0.01)}}, ("true",)),
        ({"test": {"path_slope": (1e-3, 1e-3)}}, ("true",)),
        ({**FREE, "swaps_per_s_max": 2.0}, ("true", "other", "flat")),
        ({**FREE, "jumps_max": 1e-9}, ("other",)),
        (FREE, ("high",)),
    ):
        pair = Pair(core, law, guard)
        trainer = Trainer(pair)
        fly(pair, 60)
        for kind in kinds:
            trainer.offer(kind)
        found |= set(pair.refusals)
    assert found >= {"", "misfit", "reach", "slope", "swap_rate", "weight_norm"}


@pytest.mark.parametrize("law", [*FEATURED, "attitude alone"])
def test_the_room_bites(core: Core, law: str) -> None:
    pair = Pair(core, law, {"room": {"share": (0.05, 0.01), "least": (0.01, 0.002)}, "watch": {"enabled": False}})
    fly(pair, 40)
    fly(pair, 80, "demand")
    assert pair.theirs.limited[1] > 10
    assert pair.theirs.limited[0] > 10 or law == "attitude alone"


def test_more_versions_taken_back_than_are_remembered(core: Core) -> None:
    """Here C trusts no other one, whatever strikes_max says; numpy remembers them all."""
    pair = Pair(core, "gradient", {**FREE, "strikes_max": 10**6})
    trainer, ours = Trainer(pair), pair.ours
    fly(pair, 10)
    for index in range(ours.refused_count, 64):
        content = np.frombuffer(content_of(FeatureSet(1, 0, 1, *made(pair, "true", index))), np.uint8)
        view(ours.refused)[8 * index : 8 * index + 8] = content
        pair.theirs._refused.add(content.tobytes())
    ours.refused_count = ours.strikes = pair.theirs._strikes = 64
    put_feature_set(pair.offered, FeatureSet(1, 0, 1, *made(pair, "other", 1)))
    assert REFUSALS[core.guard_offer(ours, pair.c_laws[0], pair.offered)] == "not_trusted"
    assert trainer is not None


def test_swaps_and_falls_stay_within_their_limits(core: Core) -> None:
    pair = Pair(core, "gradient", {**FREE, "swaps_per_s_max": 1e4, "watch": {"enabled": False}})
    fly(pair, 2)
    refusals = []
    for index in range(258):
        put_feature_set(pair.offered, FeatureSet(index + 1, 0, 1, *made(pair, "true", index)))
        refusals.append(REFUSALS[core.guard_offer(pair.ours, pair.c_laws[0], pair.offered)])
    assert refusals == [""] * 256 + ["swap_rate"] * 2
    for _ in range(12):
        pair.ours.level = 0
        pair.ours.config.watch.enabled, pair.ours.watches[0].worse_s = True, 9.0
        core.guard_judge(pair.ours, pair.c_laws[0], 0.005, True, False)
    falls = (core.Fall * 8)()
    assert (core.guard_take_falls(pair.ours, falls[0]), pair.ours.falls_lost) == (8, 4)


def test_contents_are_told_apart(core: Core) -> None:
    """By every number that would fly, and by nothing else."""
    pair = Pair(core, "gradient", {})
    position, attitude = made(pair, "true", 1)
    one = FeatureSet(1, 0, 5, position, attitude)
    offset = position.offset.copy()
    offset[2] += 1e-9
    layer = attitude.last_layer.copy()
    layer[5, 2] += 1e-9
    same_content = dataclasses.replace(one, version=9, parent=3, samples=7)
    others = [
        dataclasses.replace(one, position=dataclasses.replace(position, offset=offset)),
        dataclasses.replace(one, attitude=dataclasses.replace(attitude, last_layer=layer)),
        dataclasses.replace(one, attitude=None),
        dataclasses.replace(one, position=None),
        FeatureSet(1, 0, 5, None, position),
    ]
    assert content_of(same_content) == content_of(one)
    assert len({content_of(other) for other in (one, *others)}) == 1 + len(others)
