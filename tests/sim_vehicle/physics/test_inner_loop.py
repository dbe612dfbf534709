"""The inner loop of the environments: its mixer is onboard's, and its actions do what they are called."""

import numpy as np
import pytest

import sim_vehicle.physics.inner_loop as loop
import sim_vehicle.physics.layout as at
from configs.vehicle import read_vehicle
from onboard.control.airframe import AirframeConfig
from onboard.control.mixer import Mixer
from protocol.conventions import GRAVITY

AIRFRAME = AirframeConfig.model_validate(
    {key: tuple(one) if isinstance(one, list) else one for key, one in read_vehicle("mambo").airframe.items()}
)


@pytest.fixture
def settings():
    S = np.zeros(loop.SETTINGS_SIZE)
    S[loop.MASS], S[loop.GRAVITY] = AIRFRAME.mass_kg, GRAVITY
    S[loop.INERTIA : loop.INERTIA + 3] = AIRFRAME.inertia_kg_m2
    S[loop.ARM_X], S[loop.ARM_Y] = AIRFRAME.arm_x_m, AIRFRAME.arm_y_m
    S[loop.TORQUE_RATIO], S[loop.MAX_THRUST] = AIRFRAME.yaw_torque_per_thrust_m, AIRFRAME.motor_thrust_max_n
    S[loop.MIN_SHARE], S[loop.LEAD_UP], S[loop.LEAD_DOWN] = AIRFRAME.motor_thrust_min_share, 1.0, 1.0
    S[loop.POSITION_K1 : loop.POSITION_K1 + 12] = [9.0] * 3 + [5.0] * 3 + [100.0] * 3 + [20.0] * 3
    S[loop.RATES_MAX], S[loop.ACCELERATION_MAX], S[loop.RESIDUAL_MAX] = 6.0, 5.0, 3.0
    return S


def level(position=(0.0, 0.0, -1.0)):
    state = np.zeros(at.STATE_SIZE)
    state[:3], state[6] = position, 1.0
    return state


def test_the_mixer_is_onboards(settings):
    rng, mixer, limited = np.random.default_rng(1), Mixer(AIRFRAME), 0
    for _ in range(500):
        thrust = rng.uniform(0.0, 4.4 * AIRFRAME.motor_thrust_max_n)
        torque = tuple((rng.uniform(-1.0, 1.0, 3) * [0.02, 0.02, 0.003]).tolist())
        wanted, theirs = np.zeros(4), mixer.thrusts(thrust, torque)
        loop.mix(thrust, torque, settings, wanted)
        assert wanted == pytest.approx(theirs, rel=1e-12, abs=1e-12)
        limited += mixer.falls_short(theirs, thrust, torque)
    assert 100 < limited < 450


def command(mode, action, settings, state, target=None):
    path = np.zeros((1, loop.TARGET_SIZE))
    path[0, :3] = (0.0, 0.0, -1.0) if target is None else target
    commands = np.zeros((1, 4))
    actions = np.array([action], dtype=np.float64)
    loop.command_all(mode, actions, state[None], path, np.zeros(1, np.int64), settings, np.zeros(4), commands)
    return commands[0]


def test_motors_are_shares_of_full_thrust(settings):
    found = command(loop.MOTORS, [-1.0, 0.0, 1.0, 7.0], settings, level())
    assert found == pytest.approx([AIRFRAME.motor_thrust_min_share, 0.5, 1.0, 1.0])


@pytest.mark.parametrize(("axis", "pairs"), [(1, ((1, 2), (0, 3))), (2, ((0, 2), (1, 3))), (3, ((0, 1), (2, 3)))])
def test_a_rate_raises_the_motors_that_turn_that_way(settings, axis, pairs):
    action = [0.0, 0.0, 0.0, 0.0]
    action[axis] = 0.05
    found = command(loop.RATES, action, settings, level())
    (a, b), (c, d) = pairs
    assert found[a] == pytest.approx(found[b])
    assert found[a] > found[c] == pytest.approx(found[d])


def test_a_level_vehicle_at_rest_hovers_under_no_acceleration(settings):
    for mode in (loop.ACCELERATION, loop.RESIDUAL):
        found = command(mode, [0.0, 0.0, 0.0], settings, level())
        assert found.sum() * AIRFRAME.motor_thrust_max_n == pytest.approx(AIRFRAME.mass_kg * GRAVITY)
        assert np.ptp(found) < 1e-12


@pytest.mark.parametrize(("action", "higher"), [([0.2, 0, 0], (0, 2)), ([0, 0.2, 0], (1, 2)), ([0, 0, -0.2], None)])
def test_an_acceleration_tilts_the_vehicle_towards_it_or_lifts_it(settings, action, higher):
    found = command(loop.ACCELERATION, action, settings, level())
    # North is nose down: the rear motors (2, 4) push more; east is right side down: the left motors (2, 3).
    if higher is None:
        assert found.sum() * AIRFRAME.motor_thrust_max_n == pytest.approx(AIRFRAME.mass_kg * (GRAVITY + 1.0))
    elif higher == (0, 2):
        assert found[[1, 3]].min() > found[[0, 2]].max()
    else:
        assert found[[1, 2]].min() > found[[0, 3]].max()


def test_the_residual_is_added_to_the_position_loop(settings):
    beside = level((0.1, -0.2, -1.1))
    pulled = command(loop.RESIDUAL, [0.0, 0.0, 0.0], settings, beside)
    same = command(loop.ACCELERATION, np.array([-0.9, 1.8, 0.9]) / 5.0, settings, beside)
    assert pulled == pytest.approx(same)
    balanced = command(loop.RESIDUAL, np.array([0.9, -1.8, -0.9]) / 3.0, settings, beside)
    assert balanced == pytest.approx(command(loop.ACCELERATION, [0.0, 0.0, 0.0], settings, beside))
