"""From chunks to a swap, and what became of a version: the C core against numpy's, with a controller behind each."""

import dataclasses
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.c.event_text import fall_text, version_text
from onboard.c.feature_arrays import put_channel
from onboard.c.library import Core
from onboard.control.feature_reception import FeatureReception
from onboard.control.laws.adaptive import AdaptiveAugmentation
from protocol.feature_codec import encode_feature_set
from protocol.feature_set import FeatureSet
from protocol.messages import REFUSALS
from protocol.transfer import split
from tests.onboard.c.guarded_pair import SIZES, smooth_channel
from tests.onboard.c.parity import SETTINGS, configured, filled
from tests.onboard.c.test_transfer import broken, c_chunk
from tests.onboard.control.fixture import AIRFRAME, DT, shipped_controller

ALL, NONE = 0, 2
"""Of SpareTime."""
FREE = {"swaps_per_s_max": 1e3, "jumps_max": 1e3, "test": {"enabled": False}}


class Both:
    """The two receptions, each with its controller."""

    def __init__(self, core: Core, name: str = "dmrac", **guard: Any) -> None:
        self.core, self.controller = core, shipped_controller(name, {"guard": {**FREE, **guard}})
        self.theirs, self.ours, self.cascade = FeatureReception(), core.FeatureReception(), core.Cascade()
        core.reception_init(self.ours)
        start = (core.ChannelFeatures * 2)()
        for target, law in zip(start, self.controller.augmentations, strict=True):
            if isinstance(law, AdaptiveAugmentation):
                put_channel(target, law.features.channel)  # type: ignore[attr-defined]
        airframe = filled(core.AirframeConfig, AIRFRAME)
        core.cascade_init(self.cascade, configured(core, self.controller._settings), airframe, start[0])
        self.now_ns = 0

    def receive(self, chunk: Any) -> None:
        self.theirs.receive(chunk)
        self.core.reception_receive(self.ours, c_chunk(self.core, chunk))
        self.compare()

    def send(self, features: FeatureSet) -> None:
        """All chunks of a version."""
        for chunk in split(encode_feature_set(features, "float16"), features.version, 1100):
            self.receive(chunk)

    def restart(self) -> None:
        self.theirs.restart()
        self.core.reception_restart(self.ours)
        self.compare()

    def fail(self, adapting: bool = True) -> None:
        """A tick after which the law that flies has been worse for too long."""
        for side, watch in self.controller.guard._watches.items():
            watch._worse_s = self.cascade.guard.watches[side].worse_s = 1.0
        self.controller.guard.judge(DT, adapting)
        self.core.guard_judge(self.cascade.guard, self.cascade.augmentations[0], DT, adapting, False)

    def swap(self, ticks: int = 100) -> list[str]:
        """The events of both in so many ticks, by default enough to prepare a version to the end."""
        return [text for _ in range(ticks) for text in self.tick()]

    def tick(self) -> list[str]:
        self.now_ns += 5_000_000
        events, warnings = self.theirs.swap(self.controller, self.now_ns)
        outcome = self.core.VersionOutcome()
        self.core.reception_swap(self.ours, self.cascade, self.now_ns, ALL, outcome)
        texts = [version_text(outcome)] if outcome.offered else []
        texts += [fall_text(one) for one in outcome.falls[: outcome.fall_count]]
        assert [(self.now_ns, text) for text in texts] == [*events, *warnings]
        self.compare()
        return texts

    def compare(self) -> None:
        ours, theirs, status = self.ours, self.theirs, self.core.ReceptionStatus()
        self.core.reception_status(ours, status)
        received = bytes(status.received_chunks)[: status.received_chunks_size]
        numbers = status.version, status.transfer_version, received, status.refused_version, status.refusal
        assert numbers == tuple(theirs.status)
        assert (ours.swaps, ours.refusals, ours.taken_back) == (theirs.swaps, theirs.refusals, theirs.taken_back)
        assert (ours.waits, ours.prepares, ours.is_void) == (
            theirs._complete is not None,
            theirs._preparing is not None,
            theirs._void,
        )
        assert self.core.reception_age_s(ours, self.now_ns) == pytest.approx(theirs.age_s(self.now_ns), abs=1e-12)

    def report(self, statuses: int) -> list[int]:
        """The versions that so many statuses name as refused."""
        named = []
        for _ in range(statuses):
            named.append(self.theirs.status.refused_version)
            self.theirs.note_status()
            self.core.reception_note_status(self.ours)
            self.compare()
        return named


def version(number: int, seed: int, size: float = 0.05) -> FeatureSet:
    """A small version for both channels; the content depends on the seed."""
    position, attitude = (smooth_channel(side, seed, size * SIZES[side]) for side in (0, 1))
    return FeatureSet(number, 0, 5, position, attitude)


@pytest.mark.parametrize(("spare", "factor"), [(0, 1), (1, 2)])
def test_a_tick_with_little_time_leaves_out_its_part_but_never_two_in_a_row(
    core: Core, spare: int, factor: int
) -> None:
    both, outcome, ticks = Both(core), core.VersionOutcome(), 0
    both.send(version(1, 3))
    alone, last = Both(core), 0
    alone.send(version(1, 3))
    while not alone.tick():
        last += 1
    while not outcome.offered:
        core.reception_swap(both.ours, both.cascade, 5_000_000, spare, outcome)
        ticks += 1
    assert ticks == factor * (last + 1)
    assert outcome.refusal == 0


def test_without_time_a_version_is_refused(core: Core) -> None:
    """The one that is being prepared, and then the one that waits."""
    both, outcome = Both(core), core.VersionOutcome()
    both.send(version(1, 3))
    both.swap(2)
    both.send(version(2, 4))
    refused = []
    for _ in range(4):
        core.reception_swap(both.ours, both.cascade, 5_000_000, NONE, outcome)
        refused += [(outcome.version, REFUSALS[outcome.refusal])] if outcome.offered else []
    assert refused == [(1, "not_accepting"), (2, "not_accepting")]
    assert both.ours.version == 0
    both.theirs, theirs = FeatureReception(), core.FeatureReception()
    both.ours = theirs
    core.reception_init(both.ours)
    both.send(version(3, 5))
    assert "features 3 in use, parent 0, 5 samples" in both.swap(400)


WHAT = st.sampled_from(["", "", "", "name", "version", "high", "digest"])
STEPS = st.lists(
    st.tuples(st.integers(1, 5), st.integers(0, 2), WHAT, st.sampled_from(["", "", "half", "restart", "fail", "late"])),
    min_size=1,
    max_size=7,
)


@SETTINGS
@given(
    steps=STEPS, name=st.sampled_from(["dmrac", "dmrac", "indi"]), strikes=st.integers(1, 3), statuses=st.integers(0, 4)
)
def test_any_reception(core: Core, steps: Any, name: str, strikes: int, statuses: int) -> None:
    """Versions whole and broken, halves, new sessions, falls, and two versions in one tick."""
    both = Both(core, name, strikes_max=strikes)
    for number, seed, how, then in steps:
        source = version(number, seed, 60.0 if how == "high" else 0.05)
        data = broken(encode_feature_set(source, "float32"), how if how in ("name", "version") else "")
        chunks = split(data, number, 700)
        if how == "digest":
            chunks = tuple(dataclasses.replace(one, digest=bytes(16)) for one in chunks)
        for chunk in chunks[: len(chunks) // 2 if then == "half" else len(chunks)]:
            both.receive(chunk)
        if then == "restart":
            both.restart()
        if then != "late":
            both.swap(1 + 7 * (number % 3))
        if then == "fail":
            both.fail()
            both.swap(5)
        both.report(statuses)
    both.swap()
    both.report(30)


def test_a_version_is_used_taken_back_and_refused(core: Core) -> None:
    both = Both(core, watch={"enabled": False})
    both.send(version(3, 1))
    assert both.swap() == ["features 3 in use, parent 0, 5 samples"]
    both.controller.guard._config = both.controller.guard._config.model_copy(
        update={"watch": both.controller.guard._config.watch.model_copy(update={"enabled": True})}
    )
    both.cascade.guard.config.watch.enabled = True
    both.fail()
    (fall,) = both.swap()
    assert "version 3 taken back, version 0 flies" in fall
    assert (both.theirs.version, both.theirs.swapped_ns, both.theirs.taken_back) == (0, None, 1)
    both.send(version(4, 2))
    assert both.swap() == ["features 4 in use, parent 0, 5 samples"]
    both.restart()


def test_a_version_that_waits_is_forgotten_with_its_session(core: Core) -> None:
    """As is the transfer and the refusal; versions count from 1 again."""
    both = Both(core)
    for chunk in split(broken(encode_feature_set(version(7, 1), "float16"), "name"), 7, 1100):
        both.receive(chunk)
    both.send(version(9, 2))
    both.restart()
    assert both.swap() == []
    both.send(version(1, 3))
    assert both.swap() == ["features 1 in use, parent 0, 5 samples"]
