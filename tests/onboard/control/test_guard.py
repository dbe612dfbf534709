"""The guard: what is let through, what is taken back and in which order, and what survives."""

import dataclasses

import numpy as np
import pytest
from pydantic import ValidationError

from onboard.control.features import NetworkFeatures, random_channel
from onboard.control.guard import Guard, GuardConfig, Level, content_of
from onboard.control.laws.law import ChannelState
from onboard.control.room import Room, RoomConfig
from onboard.control.slope import SlopeLimits, SlopeShares
from onboard.control.version_test import VersionTest, VersionTestConfig
from onboard.control.watch import ChannelWatch, WatchConfig
from protocol.conventions import GRAVITY
from protocol.feature_set import FeatureSet
from protocol.signals import SIGNAL_COUNT, SIGNAL_INDEX
from tests.onboard.control.fixture import AIRFRAME, DT, Rig, shipped_controller
from tests.onboard.control.test_slope import ATTITUDE, POSITION

INPUTS = ("position_n", "position_e", "position_d", "velocity_n", "velocity_e", "velocity_d")
SLOW = 0.2


def version(number, theta=0.0, gain=SLOW, attitude=False):
    """Smooth features with this last layer, for the position channel or for both."""
    start = random_channel(INPUTS, np.zeros(6), np.ones(6), (8, 5), np.random.default_rng(number))
    last = np.full((6, 3), theta) * np.array([1.0, -1.0, 0.3])
    source = dataclasses.replace(start, weights=tuple(gain * W for W in start.weights), last_layer=last)
    return FeatureSet(number, 0, 100, source, source if attitude else None)


def rig(**guard):
    return Rig(shipped_controller("dmrac", {"guard": guard}))


def flown(one, seconds=0.5):
    one.fly(seconds)
    return one


def fail(guard, channel=0):
    """What a law that has been worse for too long looks like."""
    guard._watches[channel]._worse_s = 1.0
    guard.judge(DT, True)


# --- room ------------------------------------------------------------------------------------------------------------


def test_the_room_is_what_the_actuators_give_beside_the_need():
    room = Room(RoomConfig(share=(1.0, 1.0), least=(0.1, 0.1)), AIRFRAME, 0.7)
    north, east, down = room.position(1.0, (2.0, -3.0, 0.0))
    assert north == pytest.approx(GRAVITY * np.tan(0.7) - 2.0)
    assert east == pytest.approx(GRAVITY * np.tan(0.7) - 3.0)
    most = 4.0 * AIRFRAME.motor_thrust_max_n / AIRFRAME.mass_kg
    assert down == pytest.approx(min(most - GRAVITY, GRAVITY - 2.0))
    assert room.position(0.6, (0.0, 0.0, 0.0))[2] == pytest.approx(0.6 * most - GRAVITY)
    assert room.position(1.0, (99.0, 0.0, 0.0))[0] == pytest.approx(0.1 * GRAVITY * np.tan(0.7))


def test_the_room_of_the_attitude_falls_with_thrust_at_either_limit():
    room = Room(RoomConfig(), AIRFRAME, 0.7)
    most = 4.0 * AIRFRAME.motor_thrust_max_n
    rolls = [room.attitude(1.0, share * most, (0.0, 0.0, 0.0))[0] for share in (0.05, 0.5, 0.95)]
    assert rolls[1] > 1.5 * max(rolls[0], rolls[2])
    reach = 2.0 * most / 4.0 * (1.0 - AIRFRAME.motor_thrust_min_share) * AIRFRAME.arm_y_m / AIRFRAME.inertia_kg_m2[0]
    assert rolls[1] <= 0.4 * reach * 1.1


@pytest.mark.parametrize("enabled", [True, False])
def test_nu_stays_in_its_room_and_the_bites_are_counted(enabled):
    one = rig(room={"enabled": enabled}, watch={"enabled": False})
    one.controller.augmentations[0].last_layer.state.X_rows[:, -1] = 30.0
    one.controller.augmentations[0].last_layer.config = one.controller.augmentations[0].last_layer.config.model_copy(
        update={"composite_gain": 0.0}
    )
    rows = one.fly(0.1)
    largest = max(np.abs(row["position_nu"]).max() for row in rows)
    assert (largest < 10.0) == enabled
    assert (one.controller.guard.limited[0] > 0) == enabled
    if enabled:
        np.testing.assert_array_less(np.abs(one.output.position.adaptive), one.output.position.room + 1e-9)


# --- test of a version -----------------------------------------------------------------------------------------------


def cliff(at, sharp, height):
    start = version(1).position
    W = np.zeros((1, 6))
    W[0, 0] = sharp
    theta = np.zeros((2, 3))
    theta[:, 0] = height / 2.0
    return dataclasses.replace(start, weights=(W,), biases=(np.array([-sharp * at]),), last_layer=theta)


@pytest.mark.parametrize(
    ("at", "sharp", "height", "refusal"),
    [
        (0.2, 190.0, 40.0, "reach"),  # high, ahead
        (0.2, 190.0, 4.0, "slope"),  # low, but a step that no point meets
        (0.2, 0.5, 4.0, ""),
        (9.0, 190.0, 4.0, ""),  # out of reach for now
    ],
)
def test_a_cliff_ahead_is_found_wherever_the_points_lie(at, sharp, height, refusal):
    test = VersionTest(
        VersionTestConfig(),
        0,
        SlopeLimits.of("position", POSITION, ATTITUDE, SlopeShares(place=1.0, motion=1.0, turn=1.0)),
    )
    now = np.zeros(SIGNAL_COUNT)
    now[SIGNAL_INDEX["velocity_n"]] = 1.0
    channel = cliff(at, sharp, height)
    recent = np.repeat(now[:, None], 5, axis=1)
    assert test.refusal(NetworkFeatures(channel), channel.last_layer, now, recent, np.zeros((5, 3))) == refusal


@pytest.mark.parametrize(("nu", "residual", "refusal"), [(4.0, 4.0, ""), (-4.0, 4.0, "misfit"), (9.0, 0.0, "misfit")])
def test_a_map_that_contradicts_the_last_second_is_refused(nu, residual, refusal):
    test = VersionTest(
        VersionTestConfig(),
        0,
        SlopeLimits.of("position", POSITION, ATTITUDE, SlopeShares(place=1.0, motion=1.0, turn=1.0)),
    )
    channel, now = cliff(0.0, 0.0, 0.0), np.zeros(SIGNAL_COUNT)
    theta = np.array([[0.0] * 3, [nu, 0.0, 0.0]])
    recent, measured = np.zeros((SIGNAL_COUNT, 8)), np.full((8, 3), [residual, 0.0, 0.0])
    assert test.refusal(NetworkFeatures(channel), theta, now, recent, measured) == refusal


def test_the_map_that_flies_is_checked_on_what_is_ahead_by_then():
    test = VersionTest(
        VersionTestConfig(),
        0,
        SlopeLimits.of("position", POSITION, ATTITUDE, SlopeShares(place=1.0, motion=1.0, turn=1.0)),
    )
    channel, now = cliff(2.0, 190.0, 9.0), np.zeros(SIGNAL_COUNT)
    now[SIGNAL_INDEX["velocity_n"]] = 1.0
    features = NetworkFeatures(channel)
    assert test.still_good(features, channel.last_layer, now)
    now[SIGNAL_INDEX["position_n"]] = 1.7
    assert not test.still_good(features, channel.last_layer, now)


# --- the watch -------------------------------------------------------------------------------------------------------


def watched(nu, residual, seconds, config=None, level=0, error=0.0):
    watch = ChannelWatch(config or WatchConfig(), 0, (np.full(3, 16.0), np.full(3, 8.0)), (30.0, 0.0), np.zeros((6, 3)))
    state = ChannelState(dt=DT, adapt=True)
    for _ in range(round(seconds / DT)):
        state.residual[:] = residual
        state.model_error[:] = error
        watch.step(state, np.array(residual), np.full(3, nu), np.full(3, nu), level)
    return watch


def test_a_map_that_is_wrong_fails_after_its_time_and_not_before():
    assert not watched(6.0, np.ones(3), 0.14 + 0.2).failed
    watch = watched(6.0, np.ones(3), 1.0)
    assert watch.failed
    assert watch.worse(0, 1) == "misfit"


def test_a_map_that_is_as_good_as_the_bias_does_not_fail_and_proves_nothing():
    watch = watched(1.0, np.ones(3), 3.0)
    assert not watch.failed
    assert not watch.stands(1.0)


def test_a_map_that_is_a_little_wrong_loses_its_trial_and_without_one_flies_on():
    """A misfit of 1 is below the floor; over a second of evidence it is worse than the bias's."""
    wrong, floor = np.full(3, 1.6), np.full(3, 1.0)
    assert not watched(1.6, floor, 0.14 + 0.9).failed
    watch = watched(1.6, floor, 0.14 + 1.0 + 0.4)
    assert watch.failed
    assert watch.worse(0, 1) == "misfit over its trial"
    assert watch.loses(0.3)
    assert not watched(1.6, floor, 5.0, WatchConfig(trial_s=30.0)).failed
    assert not watched(1.6, wrong, 5.0).loses(0.0)


def test_evidence_is_time_in_which_the_laws_disagree():
    """The bias-only law lags behind an alternating residual that the map knows."""
    watch = ChannelWatch(WatchConfig(), 0, (np.full(3, 16.0), np.full(3, 8.0)), (30.0, 0.0), np.zeros((6, 3)))
    state = ChannelState(dt=DT, adapt=True)
    lag = round(0.14 / DT)

    def disturbance(tick):
        return 2.0 * np.sin(tick * DT * 6.0)

    for tick in range(400):
        state.residual[:] = disturbance(tick)
        now, then = np.full(3, disturbance(tick)), np.full(3, disturbance(tick + lag - 4))
        watch.step(state, state.residual, now, then, 0)
    assert watch.stands(1.0)
    assert 1.0 < watch.evidence_s < 2.0


def test_a_model_error_that_the_bias_would_not_have_had_counts():
    """nu wrong by 3 with a residual of 0: e grows as (1) says, and the bias-only law's e stays at zero."""
    config = WatchConfig(misfit_floor=(900.0, 900.0))
    watch = ChannelWatch(config, 0, (np.full(3, 16.0), np.full(3, 8.0)), (30.0, 0.0), np.zeros((6, 3)))
    state, e = ChannelState(dt=DT, adapt=True), np.zeros(6)
    for _ in range(200):
        e[3:] += DT * (3.0 - 16.0 * e[:3] - 8.0 * e[3:])
        e[:3] += DT * e[3:]
        state.model_error[:] = e
        watch.step(state, np.zeros(3), np.full(3, 3.0), np.full(3, 3.0), 0)
    assert watch.worse(0, 1) == "model error"
    assert watch.numbers[3] < 0.1 * watch.numbers[2]


# --- back and up -----------------------------------------------------------------------------------------------------


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
    for watch in guard._watches.values():
        watch.evidence_s, watch._gain = 2.0, 1.0
    guard.judge(DT, True)
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
    for watch in guard._watches.values():
        watch.evidence_s, watch._gain = 2.0, 1.0
    guard.judge(DT, True)
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
    for watch in guard._watches.values():
        watch.evidence_s, watch._gain = 2.0, 1.0
    guard.judge(DT, True)
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
    for watch in guard._watches.values():
        watch.evidence_s, watch._gain = 2.0, 1.0
    guard.judge(DT, True)
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
