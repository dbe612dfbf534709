"""Guidance: the target is continuous through leads, holds, landing and shifts."""

import numpy as np
import pytest

from configs.loader import CONFIG_DIRECTORY, fill, merge, read_tree
from onboard.estimation.state import VehicleState
from onboard.flight.guidance import Guidance, GuidanceConfig
from onboard.flight.path_turn import STEP_S, path_turn

DT = 0.005
TURN_TICKS = round(STEP_S / DT)
FIGURE8 = {"kind": "figure8", "length_m": 2.0, "width_m": 1.0, "period_s": 6.0}


def guidance(over=None):
    leads = {"feed_forward_lead_s": 0.1, "look_ahead_s": 0.17, "attitude_look_ahead_s": 0.06}
    flight = {"land_after_s": 20.0, "trajectory": {"path": FIGURE8}} | leads
    tree = merge(read_tree(CONFIG_DIRECTORY / "guidance.yaml"), flight)
    return Guidance(fill(GuidanceConfig, merge(tree, over or {}), "test"))


def started(over=None, place=(0.3, -0.2, -0.02)):
    flight, state = guidance(over), VehicleState()
    state.position[:] = place
    flight.start(state)
    return flight


def fly(flight, *phases):
    """Targets of all ticks of (run, landing, seconds) phases."""
    return [flight.step(run, landing, DT) for run, landing, seconds in phases for _ in range(round(seconds / DT))]


def columns(targets, what):
    return np.array([getattr(target.now, what) for target in targets])


def test_the_flight_begins_where_the_vehicle_stands():
    flight = started()
    first = flight.step(True, False, DT)
    np.testing.assert_allclose(first.now.position, (0.3, -0.2, -0.02), atol=1e-4)
    assert first.yaw_rad == 0.0


def test_the_target_is_continuous_through_hold_and_landing():
    targets = fly(started(), (True, False, 12), (False, False, 3), (True, False, 3), (False, True, 6))
    position, velocity = columns(targets, "position"), columns(targets, "velocity")
    np.testing.assert_allclose(np.diff(position, axis=0) / DT, 0.5 * (velocity[1:] + velocity[:-1]), atol=0.02)
    assert np.abs(np.diff(velocity, axis=0)).max() < 5.0 * DT


def climb(flight, seconds):
    """Targets while the vehicle has not reached the height of take-off."""
    return [flight.step(True, False, DT, climbing=True) for _ in range(round(seconds / DT))]


def test_the_path_waits_for_a_vehicle_that_has_not_reached_its_height():
    flight = started()
    waiting = climb(flight, 8.0)
    np.testing.assert_allclose(columns(waiting, "position")[-1], (0.3, -0.2, -1.02), atol=1e-6)
    assert np.abs(columns(waiting, "velocity")[:, :2]).max() < 1e-3
    flown = fly(flight, (True, False, 6))
    assert np.abs(np.diff(columns(waiting[-1:] + flown, "position"), axis=0)).max() < 2.0 * DT
    assert flown[-1].lap_phase >= 0.0


def test_the_path_does_not_wait_for_a_vehicle_that_climbs_with_its_target():
    flight, other = started(), started()
    climb(flight, 2.5)
    fly(other, (True, False, 2.5))
    assert fly(flight, (True, False, 8)) == fly(other, (True, False, 8))


def test_landing_descends_at_its_speed_from_the_present_target():
    flight = started()
    top = fly(flight, (True, False, 9))[-1].now.position
    down = fly(flight, (False, True, 5))
    assert down[-1].now.velocity == pytest.approx((0.0, 0.0, 0.4))
    assert down[-1].now.position[2] - top[2] == pytest.approx(0.4 * 4.5, abs=0.02)
    assert np.hypot(*(np.array(down[-1].now.position) - top)[:2]) < 0.7


def test_after_touch_down_the_target_is_where_the_vehicle_stands():
    flight = started()
    fly(flight, (True, False, 9), (False, True, 5))
    flight.rest((0.1, -0.2, -0.021))
    for target in fly(flight, (False, False, 3)):
        np.testing.assert_allclose(target.now.position, (0.1, -0.2, -0.021), atol=1e-9)
        np.testing.assert_allclose(target.now.velocity, 0.0, atol=1e-9)


def test_an_interrupted_landing_comes_to_rest():
    flight = started()
    fly(flight, (True, False, 9), (False, True, 2))
    rest = fly(flight, (False, False, 2))
    assert rest[-1].now.velocity == (0.0, 0.0, 0.0)
    assert rest[-1].now.position == rest[-50].now.position


def test_the_leads_are_the_targets_own_future():
    flight = started()
    targets = fly(flight, (True, False, 12))
    lead, ahead, attitude_ahead = round(0.10 / DT), round(0.17 / DT), round(0.06 / DT)
    for tick in (500, 1000, 2000):
        np.testing.assert_allclose(targets[tick].ahead.position, targets[tick + ahead].now.position, atol=1e-9)
        np.testing.assert_allclose(targets[tick].ahead.velocity, targets[tick + ahead].now.velocity, atol=1e-9)
        sooner = targets[tick + attitude_ahead].now
        np.testing.assert_allclose(targets[tick].attitude_ahead.position, sooner.position, atol=1e-9)
        np.testing.assert_allclose(targets[tick].feed_forward, targets[tick + lead].now.acceleration, atol=1e-9)
        about = (targets[tick + lead + step].now.acceleration for step in (-TURN_TICKS, 0, TURN_TICKS))
        np.testing.assert_allclose(targets[tick].turn, path_turn(*about), atol=1e-6)


def test_a_held_target_has_no_lead():
    held = fly(started(), (True, False, 12), (False, False, 3))[-1]
    np.testing.assert_allclose(held.ahead.position, held.now.position)
    assert held.feed_forward == (0.0, 0.0, 0.0)
    assert not np.any(held.turn)


def test_the_lap_phase_is_known_only_while_the_target_moves_as_in_the_laps_before():
    flight = started()
    assert fly(flight, (True, False, 6.4))[-1].lap_phase < 0.0
    full_speed = fly(flight, (True, False, 2.0))[-1]
    assert full_speed.lap_phase == pytest.approx((8.4 - 6.5) / 6.0)
    assert full_speed.lap_s == 6.0
    assert all(target.lap_phase < 0.0 for target in fly(flight, (False, False, 1.5)))
    assert fly(flight, (True, False, 1.5))[-1].lap_phase >= 0.0
    assert fly(flight, (False, True, 1.5))[-1].lap_phase < 0.0


def test_a_shift_moves_target_and_look_ahead_alike():
    one, other = started(), started()
    other.shift((1.0, 2.0, -0.5))
    a, b = fly(one, (True, False, 8))[-1], fly(other, (True, False, 8))[-1]
    for which in ("now", "ahead", "attitude_ahead"):
        moved = np.array(getattr(b, which).position) - getattr(a, which).position
        np.testing.assert_allclose(moved, (1.0, 2.0, -0.5))
    assert a.now.velocity == b.now.velocity


def jumped(flight, state, posed, jump):
    state.position_reset_count += 1
    state.position_jump[:] = jump
    flight.follow_jump(state, posed)


def test_after_a_jump_the_target_returns_to_the_path_at_a_limited_speed():
    flight, undisturbed, state = started(), started(), VehicleState()
    for each in (flight, undisturbed):
        fly(each, (True, False, 8))
    jumped(flight, state, True, (0.0, 0.0, 0.0))  # the first pose
    jumped(flight, state, True, (2.0, -1.0, 0.5))
    targets, plain = fly(flight, (True, False, 6)), fly(undisturbed, (True, False, 6))
    way = columns(targets, "position") - columns(plain, "position")
    np.testing.assert_allclose(way[0], (2.0, -1.0, 0.5), atol=0.01)
    speed = np.linalg.norm(np.diff(way, axis=0), axis=1) / DT
    assert 0.45 < speed.max() < 0.51
    assert np.abs(np.diff(speed)).max() < 0.06
    np.testing.assert_allclose(way[-1], 0.0, atol=1e-9)
    expected = np.gradient(way, DT, axis=0)[5:-5]
    np.testing.assert_allclose((columns(targets, "velocity") - columns(plain, "velocity"))[5:-5], expected, atol=0.03)
    for one, other in zip(targets, plain, strict=True):
        assert one.path == other.now
    ahead = np.array([one.ahead.position for one in targets])[100:600]
    np.testing.assert_allclose(ahead, columns(targets, "position")[100 + 34 : 600 + 34], atol=0.03)


def test_the_first_pose_moves_the_path_and_a_jump_before_it_does_not():
    flight, other, state = started(), started(), VehicleState()
    jumped(flight, state, False, (0.0, 0.0, -0.4))  # by range
    assert fly(flight, (True, False, 3))[-1].now == fly(other, (True, False, 3))[-1].now
    jumped(flight, state, True, (0.8, -0.6, 0.0))
    moved = np.subtract(flight.step(True, False, DT).path.position, other.step(True, False, DT).path.position)
    np.testing.assert_allclose(moved, (0.8, -0.6, 0.0))


def test_the_flight_is_finished_when_its_path_time_is_over():
    flight = started({"land_after_s": 5.0})
    fly(flight, (True, False, 4.9))
    assert not flight.finished
    fly(flight, (False, False, 3.0))
    assert flight.finished is (flight.path_time_s >= 5.0)
    fly(flight, (True, False, 2.0))
    assert flight.finished
    state = VehicleState()
    flight.start(state)
    assert flight.path_time_s == 0.0
