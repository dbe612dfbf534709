"""The guard: its room, what is let through, and what its watch judges."""

import dataclasses

import numpy as np
import pytest

from onboard.control.features import NetworkFeatures
from onboard.control.laws.law import ChannelState
from onboard.control.room import Room, RoomConfig
from onboard.control.slope import SlopeLimits, SlopeShares
from onboard.control.version_test import VersionTest, VersionTestConfig
from onboard.control.watch import ChannelWatch, WatchConfig
from protocol.conventions import GRAVITY
from protocol.signals import SIGNAL_COUNT, SIGNAL_INDEX
from tests.onboard.control.fixture import AIRFRAME, DT
from tests.onboard.control.guard_rig import rig, version
from tests.onboard.control.test_slope import ATTITUDE, POSITION

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


def looked(test, features, theta, now):
    """A whole check of the map that flies."""
    while (good := test.look(features, theta, now)) is None:
        assert test.looks
    return good


def test_the_map_that_flies_is_checked_on_what_is_ahead_by_then():
    test = VersionTest(
        VersionTestConfig(),
        0,
        SlopeLimits.of("position", POSITION, ATTITUDE, SlopeShares(place=1.0, motion=1.0, turn=1.0)),
    )
    channel, now = cliff(2.0, 190.0, 9.0), np.zeros(SIGNAL_COUNT)
    now[SIGNAL_INDEX["velocity_n"]] = 1.0
    features = NetworkFeatures(channel)
    assert looked(test, features, channel.last_layer, now)
    now[SIGNAL_INDEX["position_n"]] = 1.7
    assert not looked(test, features, channel.last_layer, now)


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
