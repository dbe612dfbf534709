"""MuJoCo as the physics: laws of mechanics, the floor, and agreement with the own physics. Needs the `mujoco` extra."""

from math import pi

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import sim_vehicle.physics.layout as at
from configs.loader import ConfigError
from protocol.conventions import GRAVITY
from sim_vehicle.config import load_vehicle
from sim_vehicle.physics.advance import advance
from sim_vehicle.physics.batch import VehicleBatch
from sim_vehicle.physics.mujoco_model import mjcf
from sim_vehicle.physics.mujoco_physics import MujocoPhysics, place
from sim_vehicle.physics.packing import pack_parameters, set_mass
from sim_vehicle.records import TRUTH
from sim_vehicle.vehicle import SimVehicle

mujoco = pytest.importorskip("mujoco", reason="the mujoco extra is not installed")

DRAG = {"drag": {"linear_n_s_m": 0.016, "quadratic_n_s2_m2": 4.7e-3}}
FLIPPED = np.diag([1.0, -1.0, -1.0])
STORM = {
    "initial": {"position_ned_m": [0.0, 0.0, -4.0], "hovering": True, "velocity_ned_m_s": [1.0, -0.6, 0.3]},
    "body": {"centre_of_mass_m": [0.002, -0.001, 0.003]},
    "disturbances": [
        {"kind": "wind", "velocity_ned_m_s": [1.0, -2.0, 0.1]},
        {"kind": "gusts", "sigma_m_s": 0.5, "length_scale_m": 0.5},
        {"kind": "cloth"},
        {"kind": "wrench", "force_ned_n": [0.02, -0.03, 0.01], "torque_frd_nm": [2e-4, -3e-4, 1e-4]},
        {"kind": "battery_sag"},
        {"kind": "payload", "mass_kg": 0.006, "offset_m": [0.02, 0.01, 0.03], "onset_s": 0.1, "end_s": 0.4},
        {"kind": "rotor_chip", "rotor": 2, "thrust_factor": 0.9, "onset_s": 0.2},
        {"kind": "motor_gain", "common": 0.95, "spread": 0.03},
    ],
}


def attitude(state):
    return Rotation.from_quat(state[6:10], scalar_first=True).as_matrix()


def run(sim, commands, seconds):
    sim.run(commands, seconds, MujocoPhysics(sim.config))


def test_free_fall(bench):
    sim = bench({"initial": {"velocity_ned_m_s": [0.5, -0.3, 0.0]}})
    run(sim, [0] * 4, 0.7)
    np.testing.assert_allclose(sim.state[:3], [0.35, -0.21, -3 + 0.5 * GRAVITY * 0.7**2], rtol=1e-12)
    np.testing.assert_allclose(sim.state[3:6], [0.5, -0.3, GRAVITY * 0.7], rtol=1e-12)
    np.testing.assert_allclose(sim.sums[at.IMU_FORCE : at.IMU_FORCE + 3], 0.0, atol=1e-10)


def test_hover_balances(bench):
    sim = bench({"initial": {"hovering": True}})
    run(sim, [0.063 * GRAVITY / 4 / 0.327] * 4, 3.0)
    np.testing.assert_allclose(sim.state[:13], [0, 0, -3, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0], atol=1e-10)
    np.testing.assert_allclose(sim.sums[at.IMU_FORCE : at.IMU_FORCE + 3], [0, 0, -3 * GRAVITY], atol=1e-10)


def test_spins_under_a_constant_torque_as_eulers_equations_say(bench):
    sim = bench()
    body, motors = sim.config.body, sim.config.motors
    commands = np.array([0.50, 0.53, 0.51, 0.47])
    T = sim.state[at.THRUST : at.THRUST + 4] = commands * motors.max_thrust_n  # constant from the start
    x, y, k = body.arm_x_m, body.arm_y_m, motors.torque_ratio_m
    torque = y * (T[1] + T[2] - T[0] - T[3]), x * (T[0] + T[2] - T[1] - T[3]), k * (T[0] + T[1] - T[2] - T[3])
    J = np.array(body.inertia_kg_m2)

    def derivative(_, z):
        R, w = z[:9].reshape(3, 3), z[9:]
        spin = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
        return np.concatenate([(R @ spin).ravel(), (torque - np.cross(w, J * w)) / J])

    start = np.array([4.0, -3.0, 5.0])
    sim.state[at.RATES : at.RATES + 3] = start
    expected = solve_ivp(derivative, (0, 0.5), [*np.eye(3).ravel(), *start], rtol=1e-11, atol=1e-12).y[:, -1]
    run(sim, commands, 0.5)
    assert np.linalg.norm(expected[9:] - start) > 5.0
    np.testing.assert_allclose(sim.state[at.RATES : at.RATES + 3], expected[9:], rtol=1e-8)
    np.testing.assert_allclose(attitude(sim.state), expected[:9].reshape(3, 3), atol=1e-7)


def test_terminal_speed(bench):
    sim = bench(DRAG | {"initial": {"position_ned_m": [0, 0, -300]}})
    run(sim, [0] * 4, 12.0)
    v = sim.state[5]
    assert 0.016 * v + 4.7e-3 * v * v == pytest.approx(0.063 * GRAVITY, rel=1e-6)


def test_a_tumble_with_a_payload_equals_that_of_the_own_physics(bench):
    """Mass, inertia with its products, and centre of mass; attitude and place all over the sky."""
    ends = []
    for physics in (advance, MujocoPhysics):
        sim = bench(DRAG | {"initial": {"velocity_ned_m_s": [0.5, -0.3, -4.0]}})
        body = sim.config.body
        set_mass(sim.P, body.mass_kg, body.inertia_kg_m2, (0.0, 0.0, 0.0), ((0.012, (0.03, -0.02, 0.04)),))
        sim.state[10:13] = 9.0, -7.0, 5.0
        sim.run([0.6, 0.5, 0.52, 0.4], 0.8, physics if physics is advance else physics(sim.config))
        ends.append(sim.state[:13].copy())
    np.testing.assert_allclose(ends[1][:10], ends[0][:10], atol=2e-4)
    np.testing.assert_allclose(ends[1][10:], ends[0][10:], atol=2e-3)


def test_the_arrays_of_mujoco_are_turned_about_the_forward_axis(bench):
    """North, east, down becomes north, west, up, and the same for the body."""
    sim = bench()
    sim.state[:3], sim.state[3:6], sim.state[10:13] = (1.0, 2.0, -3.0), (0.1, 0.2, 0.3), (4.0, 5.0, 6.0)
    sim.state[6:10] = np.array([0.3, -0.5, 0.1, 0.8]) / np.linalg.norm([0.3, -0.5, 0.1, 0.8])
    model = mujoco.MjModel.from_xml_string(mjcf(sim.P))
    data = mujoco.MjData(model)
    place(sim.state, data.qpos, data.qvel)
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.xpos[1], [1.0, -2.0, 3.0])
    np.testing.assert_allclose(data.xmat[1].reshape(3, 3), FLIPPED @ attitude(sim.state) @ FLIPPED, atol=1e-14)
    velocity = np.zeros(6)
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, 1, velocity, 0)
    np.testing.assert_allclose(velocity[3:], [0.1, -0.2, -0.3], atol=1e-14)
    np.testing.assert_allclose(velocity[:3], FLIPPED @ attitude(sim.state) @ [4.0, 5.0, 6.0], atol=1e-12)


def test_the_model_has_the_mass_and_inertia_of_the_parameters():
    P = pack_parameters(load_vehicle())
    set_mass(P, 0.06, (1e-4, 1.5e-4, 2e-4), (0.002, -0.001, 0.003), ((0.02, (0.01, 0.02, 0.03)),))
    model = mujoco.MjModel.from_xml_string(mjcf(P))
    xx, yy, zz, xy, xz, yz = P[at.INERTIA : at.INERTIA + 6]
    axes = Rotation.from_quat(model.body_iquat[1], scalar_first=True).as_matrix()
    J = FLIPPED @ axes @ np.diag(model.body_inertia[1]) @ axes.T @ FLIPPED
    np.testing.assert_allclose(J, [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], rtol=1e-6, atol=1e-12)
    assert model.body_mass[1] == pytest.approx(0.08)
    np.testing.assert_allclose(FLIPPED @ model.body_ipos[1], P[at.CENTRE : at.CENTRE + 3], rtol=1e-12)


def test_stands_still_on_the_floor(bench):
    sim = bench({"initial": {"position_ned_m": None, "yaw_rad": 0.7}})
    run(sim, [0] * 4, 1.0)  # it settles
    start = sim.state[:13].copy()
    sim.sums[:] = 0.0
    run(sim, [0] * 4, 5.0)
    np.testing.assert_allclose(sim.state[:13], start, atol=1e-7)
    np.testing.assert_allclose(sim.sums[at.IMU_FORCE : at.IMU_FORCE + 3], [0, 0, -5 * GRAVITY], atol=1e-6)
    assert -0.022 < sim.state[2] < -0.0215
    assert sim.state[at.AIRBORNE] == 0


@pytest.mark.parametrize("tilt", [0.0, 0.3, pi - 0.2])
def test_comes_to_rest_after_a_drop(bench, tilt):
    sim = bench({"initial": {"position_ned_m": [0.0, 0.0, -0.2], "velocity_ned_m_s": [0.4, 0.0, 0.0]}})
    sim.state[6:10] = np.cos(tilt / 2), np.sin(tilt / 2), 0.0, 0.0
    run(sim, [0] * 4, 4.0)
    np.testing.assert_allclose(sim.state[3:6], 0.0, atol=1e-3)
    np.testing.assert_allclose(sim.state[10:13], 0.0, atol=1e-2)
    assert -0.03 < sim.state[2] < -0.01
    assert sim.sums[at.TOUCH_SPEED] == pytest.approx(np.sqrt(2 * GRAVITY * 0.17), rel=0.1)


def test_friction_holds_a_pushed_vehicle_until_it_slides(bench):
    """The wind's drag on the standing vehicle stays below Coulomb's limit, or exceeds it."""
    weight_n = 0.063 * GRAVITY
    for share, slides in ((0.8, False), (1.2, True)):
        wind = {"kind": "wind", "velocity_ned_m_s": [share * 0.6 * weight_n / 0.05, 0.0, 0.0]}
        over = {"drag": {"linear_n_s_m": 0.05, "quadratic_n_s2_m2": 0.0}, "body": {"rotor_height_m": 0.0}}
        vehicle = SimVehicle(load_vehicle("mambo", over | {"physics": "mujoco", "disturbances": [wind]}), 1)
        north_m = vehicle.step(2_000_000_000).truth[0]
        assert north_m > 0.3 if slides else abs(north_m) < 0.01  # soft friction creeps a little


def test_agrees_with_the_own_physics_through_all_disturbances(open_loop):
    own, _ = open_loop(STORM, 3, 0.6)
    other, _ = open_loop(STORM | {"physics": "mujoco"}, 3, 0.6)
    column = {name: index for index, name in enumerate(TRUTH.names)}
    for name, tolerance in (("position_n", 1e-4), ("velocity_e", 1e-3), ("rate_p", 1e-2), ("quaternion_x", 1e-3)):
        np.testing.assert_allclose(other[:, column[name]], own[:, column[name]], atol=tolerance, err_msg=name)
    force = [column[f"disturbance_force_{axis}"] for axis in "ned"]
    torque = [column[f"disturbance_torque_{axis}"] for axis in "xyz"]
    np.testing.assert_allclose(other[:, force], own[:, force], atol=2e-3)
    np.testing.assert_allclose(other[:, torque], own[:, torque], atol=2e-5)
    assert np.abs(own[-1, 10:13]).max() > 1.0
    assert not np.array_equal(own, other)


def test_the_same_seed_gives_the_same_flight_however_often_it_is_stepped(open_loop):
    flights = [
        open_loop(STORM | {"physics": "mujoco"}, seed, 0.45, step_ns)[1]
        for seed, step_ns in ((5, 5_000_000), (5, 5_000_000), (5, 1_000_000), (6, 5_000_000))
    ]
    assert flights[0] == flights[1] == flights[2]
    assert flights[0] != flights[3]


def test_a_disturbance_of_the_users_own_acts(tether, open_loop):
    """The tether pulls north with a force that its settings give; it changes little in 0.1 s."""
    over = {"initial": {"position_ned_m": [0.0, 0.0, -1.0], "hovering": True}, "physics": "mujoco"}
    pulled = {"disturbances": [tether | {"onset_s": 0.0}]}
    north_m = [open_loop(over | more, 1, 0.1)[0][-1, 0] for more in ({}, pulled)]
    force_n = tether["stiffness_n_m"] * (tether["anchor_ned_m"][0] - tether["length_m"])
    assert north_m[1] - north_m[0] == pytest.approx(0.5 * force_n / 0.063 * 0.1**2, rel=0.05)


def test_a_hard_landing_loses_the_vehicle():
    fall = {"initial": {"position_ned_m": [0.0, 0.0, -0.5]}, "physics": "mujoco"}
    vehicle = SimVehicle(load_vehicle("mambo", fall), 1)
    vehicle.step(1_000_000_000)
    assert vehicle.crash_reason.startswith("hit the floor at 2.9")


def test_an_inertia_that_no_body_has_is_refused():
    """MuJoCo wants each moment to be at most the sum of the others; the own physics takes any."""
    over = {"body": {"inertia_kg_m2": [1e-5, 1e-5, 1e-4]}}
    SimVehicle(load_vehicle("mambo", over), 1)
    with pytest.raises(ConfigError, match=r"vehicle\.body: MuJoCo refuses it: .*inertia"):
        SimVehicle(load_vehicle("mambo", over | {"physics": "mujoco"}), 1)


def test_a_batch_has_the_own_physics_only():
    with pytest.raises(ValueError, match="physics"):
        VehicleBatch(load_vehicle("mambo", {"physics": "mujoco"}), (1, 2))
