"""The guard's way back and up: what is taken back and in which order, and what survives."""

import dataclasses

import numpy as np
import pytest
from pydantic import ValidationError

from onboard.control.guard import Guard, GuardConfig, Level, content_of
from protocol.signals import SIGNAL_INDEX
from tests.onboard.control.fixture import DT, Rig, shipped_controller
from tests.onboard.control.guard_rig import fail, flown, rig, version


def prove(guard):
    """What enough evidence for the map looks like, in both channels."""
    for watch in guard._watches.values():
        watch.evidence_s, watch._gain = 2.0, 1.0
    guard.judge(DT, True)


def test_a_bad_version_goes_back_to_the_good_one_with_its_w_then_to_the_bias_then_to_none():
    one = flown(rig())
    guard = one.controller.guard
    W = one.controller.augmentations[0].last_layer.W.copy()
    start = one.controller.augmentations[0].features
    assert guard.offer(version(1, 0.3)) == ""
    assert one.controller.augmentations[0].features is not start
    fail(guard)
    assert (guard.level, guard.version) == (Level.MAP, 0)
    assert one.controller.augmentations[0].features is start
    np.testing.assert_allclose(one.controller.augmentations[0].last_layer.W, W, atol=1e-12)
    fail(guard, 1)
    assert guard.level is Level.BIAS
    fail(guard)
    assert guard.level is Level.NONE
    fail(guard)
    assert guard.level is Level.NONE
    falls = guard.take_falls()
    assert [fall.refused for fall in falls] == [1, 0, 0]
    assert guard.take_falls() == []
    one.fly(0.05)
    np.testing.assert_array_equal(one.output.position.adaptive, 0.0)
    assert one.output.law == 2


def test_the_command_is_the_bias_alone_after_a_fall():
    one = flown(rig(), 0.3)
    one.force = np.array([1.0, -0.5, 0.3])
    guard = one.controller.guard
    fail(guard)
    one.fly(1.0)
    np.testing.assert_allclose(one.output.position.adaptive, one.force, atol=0.1)
    assert np.linalg.norm(one.position - one.target) < 0.05


def test_a_version_taken_back_is_refused_under_any_number():
    one = flown(rig())
    guard = one.controller.guard
    bad = version(1, 0.3)
    assert guard.offer(bad) == ""
    fail(guard)
    assert guard.offer(dataclasses.replace(bad, version=7)) == "taken_back"
    assert guard.offer(version(8, 0.3)) == ""


def test_the_good_version_is_refused_too_once_it_has_failed():
    """After a fall to it, the content that is remembered is its own."""
    one = flown(rig())
    guard = one.controller.guard
    good, bad = version(1, 0.3), version(2, 0.3)
    assert guard.offer(good) == ""
    prove(guard)
    assert guard.offer(bad) == ""
    fail(guard)
    assert guard.version == 1
    fail(guard)
    assert [fall.refused for fall in guard.take_falls()] == [2, 1]
    assert guard.offer(dataclasses.replace(good, version=7)) == "taken_back"
    assert guard.offer(dataclasses.replace(bad, version=8)) == "taken_back"


def test_after_so_many_strikes_no_version_is_accepted():
    one = flown(rig(strikes_max=2))
    guard = one.controller.guard
    for number in (1, 2):
        assert guard.offer(version(number, 0.3)) == ""
        fail(guard)
        guard._time_s += 1.1
    assert guard.offer(version(3, 0.3)) == "not_trusted"


def test_only_proven_versions_are_kept_as_good():
    one = flown(rig())
    guard = one.controller.guard
    assert guard.offer(version(1, 0.3)) == ""
    assert guard.offer(version(2, 0.3)) == ""
    fail(guard)
    assert guard.version == 0  # not 1, of which nothing is known
    guard._time_s += 2.0
    assert guard.offer(version(3, 0.3)) == ""
    prove(guard)
    assert guard.offer(version(4, 0.3)) == ""
    fail(guard)
    assert guard.version == 3


def test_a_version_that_loses_when_the_next_one_comes_is_taken_back_first():
    """So a bad one cannot hide behind its successor; it is no strike, because it had no full trial."""
    one = flown(rig(strikes_max=1))
    guard = one.controller.guard
    assert guard.offer(version(1, 0.3)) == ""
    for watch in guard._watches.values():
        watch.evidence_s, watch._trial = 0.5, (2.0, 1.0)
    guard._time_s += 1.1
    assert guard.offer(version(2, 0.3)) == ""
    assert guard.version == 2
    assert [fall.refused for fall in guard.take_falls()] == [1]
    fail(guard)
    assert guard.version == 0


def test_without_the_watch_no_version_is_taken_back_by_its_trial():
    """An ablation is off in every part."""
    one = flown(rig(watch={"enabled": False}))
    guard = one.controller.guard
    assert guard.offer(version(1, 0.3)) == ""
    for watch in guard._watches.values():
        watch.evidence_s, watch._trial = 0.5, (2.0, 1.0)
    guard._time_s += 1.1
    assert guard.offer(version(2, 0.3)) == ""
    assert guard.take_falls() == []


@pytest.mark.parametrize("proven", [False, True])
def test_what_flies_gets_the_number_under_which_it_comes_again(proven):
    """So that a refusal names the number that the trainer knows; W and the evidence stay."""
    one = flown(rig())
    guard = one.controller.guard
    assert guard.offer(version(1, 0.3)) == ""
    if proven:
        for watch in guard._watches.values():
            watch.evidence_s, watch._gain = 2.0, 1.0
        guard.judge(DT, True)
    W, evidence_s = guard._learners[0].last_layer.W, guard._watches[0].evidence_s
    assert guard.offer(dataclasses.replace(version(1, 0.3), version=6)) == ""
    assert guard.version == 6
    np.testing.assert_array_equal(guard._learners[0].last_layer.W, W)
    assert guard._watches[0].evidence_s == evidence_s
    fail(guard)
    assert [fall.refused for fall in guard.take_falls()] == [6]


def test_the_good_version_gets_its_new_number_too():
    one = flown(rig())
    guard = one.controller.guard
    good = version(1, 0.3)
    assert guard.offer(good) == ""
    prove(guard)
    assert guard.offer(version(2, 0.3)) == ""
    fail(guard)
    assert guard.version == 1
    assert guard.offer(dataclasses.replace(good, version=5)) == ""
    fail(guard)
    assert [fall.refused for fall in guard.take_falls()] == [2, 5]
    assert guard.level is Level.BIAS, (
        "the good one has failed under its new number: there is nothing else to go back to"
    )


def test_swaps_a_second_are_limited():
    one = flown(rig(swaps_per_s_max=2))
    guard = one.controller.guard
    assert [guard.offer(version(number, 0.1)) for number in (1, 2, 3)] == ["", "", "swap_rate"]
    guard._time_s += 1.1
    assert guard.offer(version(4, 0.1)) == ""


def test_the_sum_of_jumps_is_limited():
    one = flown(rig(jumps_max=1e-6))
    one.target = np.array([0.5, 0.0, -1.0])
    one.controller.augmentations[0]._signals[SIGNAL_INDEX["position_n"], 1] += 0.5
    assert one.controller.guard.offer(version(1, 2.0, gain=1.0)) == "swap_rate"


def test_theta_from_before_the_flight_flies_only_after_its_audition():
    one = rig()
    guard = one.controller.guard
    one.controller.reset(one.inputs())
    assert guard.offer(version(1, 0.3)) == ""
    assert guard.level is Level.BIAS
    one.fly(0.5)
    assert guard.level is Level.BIAS
    prove(guard)
    assert guard.level is Level.MAP
    assert "after its audition" in guard.take_falls()[0].text


def test_what_was_learnt_outlives_the_trainer():
    """Nothing that the guard keeps depends on the peer: a restart of the reception leaves the version and its W."""
    one = flown(rig())
    guard = one.controller.guard
    assert guard.offer(version(5, 0.3)) == ""
    W = one.controller.augmentations[0].last_layer.W.copy()
    assert guard.offer(version(6, 30.0)) in ("reach", "slope", "weight_norm")
    assert guard.version == 5
    np.testing.assert_array_equal(one.controller.augmentations[0].last_layer.W, W)


def test_content_does_not_depend_on_the_number():
    one = version(1, 0.3)
    assert content_of(one) == content_of(dataclasses.replace(one, version=2, samples=5))
    assert content_of(one) != content_of(version(1, 0.31))


def test_a_controller_without_learnt_features_is_not_watched():
    one = Rig(shipped_controller("indi"))
    assert isinstance(one.controller.guard, Guard)
    assert one.controller.guard.offer(version(1)) == "not_accepting"


@pytest.mark.parametrize(
    "bad", [{"strikes_max": 0}, {"watch": {"margin": 0.5}}, {"room": {"share": [0.0, 1.0]}}, {"swaps_per_s_max": -1}]
)
def test_settings_out_of_range_are_refused(bad):
    with pytest.raises(ValidationError):
        GuardConfig(**bad)


def agree(guard):
    """What a second looks like in which the map said what the bias says, in both channels."""
    for watch in guard._watches.values():
        watch.evidence_s, watch.agreed_s = 0.0, 1.5
    guard.judge(DT, True)


def test_a_version_from_the_ground_that_agrees_with_the_bias_flies_after_a_second():
    one = rig()
    guard = one.controller.guard
    assert guard.offer(version(1, 0.3, attitude=True)) == ""
    assert guard.level is Level.BIAS
    guard._watches[0].agreed_s = 1.5
    guard.judge(DT, True)
    assert guard.level is Level.BIAS, "one channel is not enough"
    agree(guard)
    assert guard.level is Level.MAP
    assert "after its audition" in guard.take_falls()[-1].text


def test_agreement_is_not_enough_for_a_map_that_failed():
    one = flown(rig())
    guard = one.controller.guard
    fail(guard)
    assert guard.level is Level.BIAS
    agree(guard)
    assert guard.level is Level.BIAS
    prove(guard)
    assert guard.level is Level.MAP


def lose(guard):
    """A version that is worse than the bias when the next one comes."""
    guard._watches[0].evidence_s, guard._watches[0]._trial = 0.5, (4.0, 1.0)


def test_after_so_many_losses_in_a_row_a_version_needs_evidence_before_it_flies():
    one = flown(rig(losses_max=2, swaps_per_s_max=100.0, jumps_max=100.0))
    guard = one.controller.guard
    for number in (1, 2):
        assert guard.offer(version(number, 0.3)) == ""
        assert guard.level is Level.MAP
        lose(guard)
    assert guard.offer(version(3, 0.3)) == ""
    assert guard.level is Level.BIAS
    agree(guard)
    assert guard.level is Level.BIAS
    prove(guard)
    assert guard.level is Level.MAP
    guard.judge(DT, True)
    prove(guard)
    assert guard.offer(version(4, 0.3)) == ""
    assert guard.level is Level.MAP, "a proven version ends the row"
