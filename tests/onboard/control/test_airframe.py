"""Mixer and actuator model: exact inside the limits, yaw given up first, then thrust, then roll and pitch."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from configs.loader import fill
from configs.vehicle import read_vehicle
from onboard.control.actuators import ActuatorModel
from onboard.control.airframe import AirframeConfig
from onboard.control.mixer import Mixer
from protocol.conventions import GRAVITY

AIRFRAME = fill(AirframeConfig, read_vehicle("mambo").airframe, "mambo.yaml")
DRIVEN = AIRFRAME.model_copy(update={"motor_response_s": 0.02})
LOW, HIGH = AIRFRAME.motor_thrust_min_share * AIRFRAME.motor_thrust_max_n, AIRFRAME.motor_thrust_max_n
SETTINGS = settings(max_examples=200, deadline=None, derandomize=True)
motors = st.tuples(*[st.floats(LOW, HIGH)] * 4)
demands = st.tuples(st.floats(-1.0, 3.0), st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.floats(-0.01, 0.01))


def wrench(thrusts):
    """Thrust and torque of four motors from first principles: cross products, and reaction against the rotation."""
    x, y, k = AIRFRAME.arm_x_m, AIRFRAME.arm_y_m, AIRFRAME.yaw_torque_per_thrust_m
    places = np.array([[x, y, 0], [-x, -y, 0], [x, -y, 0], [-x, y, 0]])
    torque = sum(np.cross(place, (0.0, 0.0, -T)) for place, T in zip(places, thrusts, strict=True))
    clockwise = np.array([-1.0, -1.0, 1.0, 1.0])  # seen from above, positive about body down
    torque[2] = -k * float(clockwise @ np.array(thrusts))
    return sum(thrusts), *torque


@SETTINGS
@given(motors)
def test_what_the_motors_can_do_is_met_exactly(thrusts):
    thrust, *torque = wrench(thrusts)
    np.testing.assert_allclose(Mixer(AIRFRAME).thrusts(thrust, tuple(torque)), thrusts, atol=1e-9)


@SETTINGS
@given(demands)
def test_every_motor_stays_within_its_limits(demand):
    thrusts = Mixer(AIRFRAME).thrusts(demand[0], demand[1:])
    assert all(LOW - 1e-12 <= thrust <= HIGH + 1e-12 for thrust in thrusts)


@SETTINGS
@given(demands)
def test_the_order_of_giving_up(demand):
    """Roll and pitch are met if any thrust allows them, thrust if any yaw allows it; yaw gets what is left."""
    thrust, roll, pitch, yaw = demand
    got = wrench(Mixer(AIRFRAME).thrusts(thrust, (roll, pitch, yaw)))
    share = 2.0 * (abs(roll) / (4 * AIRFRAME.arm_y_m) + abs(pitch) / (4 * AIRFRAME.arm_x_m)) / (HIGH - LOW)
    if share <= 1.0:
        assert got[1] == pytest.approx(roll, abs=1e-9)
        assert got[2] == pytest.approx(pitch, abs=1e-9)
    else:  # shrunk together, their direction kept
        assert got[1] == pytest.approx(roll / share, abs=1e-9)
        assert got[2] == pytest.approx(pitch / share, abs=1e-9)
    room = 2.0 * min(share, 1.0) * (HIGH - LOW)
    low, high = 4 * LOW + room, 4 * HIGH - room
    if low <= thrust <= high:  # possible without yaw, so yaw may not spoil it
        assert got[0] == pytest.approx(thrust, abs=1e-9)
    else:  # as near as without yaw, or nearer
        assert abs(got[0] - thrust) <= abs(min(max(thrust, low), high) - thrust) + 1e-9
    assert abs(got[3]) <= abs(yaw) + 1e-9
    assert got[3] * yaw >= -1e-12


@SETTINGS
@given(demands, st.tuples(*[st.floats(-1e-6, 1e-6)] * 4))
def test_the_mixer_has_no_jumps(demand, change):
    mixer = Mixer(AIRFRAME)
    before = mixer.thrusts(demand[0], demand[1:])
    scale = (1.0, AIRFRAME.arm_x_m, AIRFRAME.arm_y_m, AIRFRAME.yaw_torque_per_thrust_m)
    moved = [x + dx * unit for x, dx, unit in zip(demand, change, scale, strict=True)]
    np.testing.assert_allclose(mixer.thrusts(moved[0], tuple(moved[1:])), before, atol=2e-5)


@SETTINGS
@given(demands)
def test_yaw_takes_all_that_is_left(demand):
    thrust, roll, pitch, yaw = demand
    mixer = Mixer(AIRFRAME)
    thrusts = mixer.thrusts(thrust, (roll, pitch, yaw))
    missing = abs(yaw) - abs(wrench(thrusts)[3])
    assume(missing > 1e-9)
    assert min(min(T - LOW for T in thrusts), min(HIGH - T for T in thrusts)) < 1e-9


def test_yaw_is_given_up_before_thrust():
    thrust = 4 * HIGH - 0.02
    got = wrench(Mixer(AIRFRAME).thrusts(thrust, (0.0, 0.0, 1.0)))
    assert got[0] == pytest.approx(thrust)
    assert 0.0 < got[3] < 1.0


@pytest.mark.parametrize(("command", "lag_s"), [(0.3, AIRFRAME.motor_lag_up_s), (0.0, AIRFRAME.motor_lag_down_s)])
def test_the_actuator_model_is_the_exact_first_order_lag(command, lag_s):
    model = ActuatorModel(AIRFRAME, 0.005)
    model.delivered.thrusts_n[:] = 0.15
    for _ in range(10):
        model.step((command / HIGH,) * 4)
    expected = command + (0.15 - command) * math.exp(-0.05 / lag_s)
    np.testing.assert_allclose(model.delivered.thrusts_n, expected, rtol=1e-12)


@SETTINGS
@given(motors)
def test_the_actuator_models_wrench(thrusts):
    model = ActuatorModel(AIRFRAME, 0.005)
    model.delivered.thrusts_n[:] = thrusts
    thrust, torque = model.step(tuple(thrust / HIGH for thrust in thrusts))[1:]
    np.testing.assert_allclose((thrust, *torque), wrench(thrusts), atol=1e-12)


def test_the_airframe_can_hover_and_turn():
    hover = AIRFRAME.mass_kg * GRAVITY
    got = wrench(Mixer(AIRFRAME).thrusts(hover, (1e-3, -1e-3, 1e-4)))
    np.testing.assert_allclose(got, (hover, 1e-3, -1e-3, 1e-4), atol=1e-12)


@pytest.mark.parametrize(("start", "wanted"), [(0.15, 0.16), (0.16, 0.15)])
def test_driven_motors_follow_with_the_response_and_not_with_their_lag(start, wanted):
    model = ActuatorModel(DRIVEN, 0.0005)
    model.delivered.thrusts_n[:] = start
    for _ in range(round(DRIVEN.motor_response_s / 0.0005)):
        model.step(model.overdriven((wanted,) * 4))
    share = (model.delivered.thrusts_n - start) / (wanted - start)
    np.testing.assert_allclose(share, 1.0 - np.exp(-1.0), atol=0.01)


def test_motors_are_left_as_they_are_where_the_response_is_no_shorter_than_the_lag():
    slow = AIRFRAME.model_copy(update={"motor_response_s": AIRFRAME.motor_lag_down_s})
    model, wanted = ActuatorModel(slow, 0.005), (0.1, 0.15, 0.2, 0.25)
    model.delivered.thrusts_n[:] = 0.17
    assert model.overdriven(wanted) == pytest.approx([thrust / HIGH for thrust in wanted], rel=1e-12)


def test_driven_motors_keep_their_limits_and_stand_where_they_are_wanted():
    model = ActuatorModel(DRIVEN, 0.005)
    model.delivered.thrusts_n[:] = 0.15
    assert model.overdriven((0.15,) * 4) == pytest.approx((0.15 / HIGH,) * 4)
    least = AIRFRAME.motor_thrust_min_share
    assert model.overdriven((HIGH, LOW, HIGH, LOW)) == pytest.approx((1.0, least, 1.0, least))


def test_near_full_thrust_a_torque_takes_no_thrust():
    """One pair is to rise to its limit, the other to fall as much: the leads of both shrink alike."""
    model, hover = ActuatorModel(DRIVEN, 0.005), 0.9 * HIGH
    model.delivered.thrusts_n[:] = hover
    wanted = (0.98 * HIGH, 0.82 * HIGH, 0.98 * HIGH, 0.82 * HIGH)
    command = model.overdriven(wanted)
    lags = np.array([DRIVEN.motor_lag_up_s, DRIVEN.motor_lag_down_s] * 2) / DRIVEN.motor_response_s - 1.0
    full = lags * np.array([0.08, -0.08] * 2)
    assert command[0] == pytest.approx(1.0)
    assert command[1] == pytest.approx(0.82 + full[1] * 0.02 / full[0])
    one_by_one = np.minimum(np.array(wanted) / HIGH + full, 1.0)
    assert model.ahead(command).thrust_n > model.ahead(tuple(one_by_one.tolist())).thrust_n + 1e-3
    model.delivered.thrusts_n[:] = 0.5 * HIGH  # with room, each motor has all of its lead
    middle = np.array([0.55, 0.45] * 2)
    np.testing.assert_allclose(
        model.overdriven(tuple((HIGH * middle).tolist())), middle + lags * np.array([0.05, -0.05] * 2)
    )


def test_motors_that_give_less_keep_their_shares_and_their_limits_fall():
    """A change of the thrust scale is no step of the commands."""
    model, mixer = ActuatorModel(DRIVEN, 0.005), Mixer(DRIVEN)
    shares = (0.4, 0.5, 0.45, 0.55)
    for _ in range(400):
        full = model.step(shares)
    model.scale = mixer.scale = 0.7
    np.testing.assert_allclose(model.delivered.thrusts_n, 0.7 * full.thrusts_n, rtol=1e-12)
    assert model.delivered.thrust_n == pytest.approx(0.7 * full.thrust_n)
    assert model.delivered.torque_nm == pytest.approx([0.7 * torque for torque in full.torque_nm])
    np.testing.assert_allclose(model.step(shares).thrusts_n, 0.7 * full.thrusts_n, rtol=1e-5)
    assert mixer.thrusts(100.0, (0.0, 0.0, 0.0)) == pytest.approx((0.7 * HIGH,) * 4)
    assert mixer.thrusts(0.0, (0.0, 0.0, 0.0)) == pytest.approx((0.7 * LOW,) * 4)
    assert model.overdriven((HIGH, 0.0, HIGH, 0.0)) == pytest.approx((1.0, DRIVEN.motor_thrust_min_share) * 2)
    standing = tuple(model.delivered.thrusts_n.tolist())
    assert model.overdriven(standing) == pytest.approx(shares, rel=1e-5)
