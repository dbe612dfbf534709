"""RotorPy as the physics: laws of mechanics, motors and air, and agreement with the own physics. Needs the extra."""

import gc
from math import exp, pi, sqrt

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
from sim_vehicle.physics.packing import pack_parameters, set_mass
from sim_vehicle.physics.parameters import RotorpyConfig
from sim_vehicle.physics.rotorpy_model import hover_speed, quad_params
from sim_vehicle.physics.rotorpy_physics import QUATERNION, RATES, ROTORPY_SIZE, WIND, RotorpyPhysics, place
from sim_vehicle.records import TRUTH
from sim_vehicle.vehicle import SimVehicle

pytest.importorskip("rotorpy", reason="the rotorpy extra is not installed")
hummingbird = pytest.importorskip("rotorpy.vehicles.hummingbird_params")
multirotor = pytest.importorskip("rotorpy.vehicles.multirotor")

WEIGHT_N = 0.063 * GRAVITY
HOVER = WEIGHT_N / 4 / 0.327
LINEAR, QUADRATIC = 0.016, 4.7e-3
DRAG = {"drag": {"linear_n_s_m": LINEAR, "quadratic_n_s2_m2": QUADRATIC}}
FLIPPED = np.diag([1.0, -1.0, -1.0])
COLUMN = {name: index for index, name in enumerate(TRUTH.names)}
WINDS = [COLUMN[f"wind_{axis}"] for axis in "ned"]
NO_AIR_AND_FAST_MOTORS = {
    "drag": {"linear_n_s_m": 0.0, "quadratic_n_s2_m2": 0.0},
    "motors": {"lag_up_s": 0.002, "lag_down_s": 0.002},
}
"""RotorPy's own motors and air are all that differs on purpose."""
LOADS = NO_AIR_AND_FAST_MOTORS | {
    "initial": {"position_ned_m": [0.0, 0.0, -0.25], "hovering": True, "velocity_ned_m_s": [1.0, -0.6, -0.5]},
    "body": {"centre_of_mass_m": [0.002, -0.001, 0.003]},
    "disturbances": [
        {"kind": "wind", "velocity_ned_m_s": [1.0, -2.0, 0.1]},
        {"kind": "gusts", "sigma_m_s": 0.5, "length_scale_m": 0.5},
        {"kind": "cloth"},
        {"kind": "wrench", "force_ned_n": [0.02, -0.03, 0.01], "torque_frd_nm": [2e-4, -3e-4, 1e-4]},
        {"kind": "battery_sag"},
        {"kind": "payload", "mass_kg": 0.006, "offset_m": [0.02, 0.01, 0.03], "onset_s": 0.1, "end_s": 0.3},
        {"kind": "rotor_chip", "rotor": 2, "thrust_factor": 0.9, "onset_s": 0.2},
        {"kind": "motor_gain", "common": 0.95, "spread": 0.03},
    ],
}
"""All that RotorPy does not model itself, near the floor, where the ground effect counts."""
TUNNEL = {"kind": "rotorpy_tunnel", "origin_ned_m": [0.6, -2.0, -1.0], "direction_ned": [0.0, 2.0, 0.0]}
TUNNEL |= {"radius_m": 0.3, "speed_m_s": 4.0}
SINUSOID = {"kind": "rotorpy_sinusoid", "amplitude_ned_m_s": [1.0, -2.0, 0.5], "frequency_ned_hz": [2.0, 1.0, 3.0]}


def attitude(state):
    return Rotation.from_quat(state[6:10], scalar_first=True).as_matrix()


def run(sim, commands, seconds):
    sim.run(commands, seconds, RotorpyPhysics(sim.config))


def in_hover(bench, velocity, rotorpy=None):
    """A vehicle with drag and hover thrust, and one sub-step of hover commands."""
    over = DRAG | {"initial": {"hovering": True, "velocity_ned_m_s": velocity}, "physics": "rotorpy"}
    sim = bench(over if rotorpy is None else over | {"rotorpy": rotorpy})
    run(sim, [HOVER] * 4, 0.001)
    return sim


def test_free_fall(bench):
    sim = bench({"initial": {"velocity_ned_m_s": [0.5, -0.3, 0.0]}})
    run(sim, [0] * 4, 0.7)
    np.testing.assert_allclose(sim.state[:3], [0.35, -0.21, -3 + 0.5 * GRAVITY * 0.7**2], rtol=1e-12)
    np.testing.assert_allclose(sim.state[3:6], [0.5, -0.3, GRAVITY * 0.7], rtol=1e-12)
    np.testing.assert_allclose(sim.sums[at.IMU_FORCE : at.IMU_FORCE + 3], 0.0, atol=1e-10)


def test_hover_balances(bench):
    sim = bench(DRAG | {"initial": {"hovering": True}})
    run(sim, [HOVER] * 4, 3.0)
    np.testing.assert_allclose(sim.state[:13], [0, 0, -3, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0], atol=1e-10)
    np.testing.assert_allclose(sim.sums[at.IMU_FORCE : at.IMU_FORCE + 3], [0, 0, -3 * GRAVITY], atol=1e-10)


@pytest.mark.parametrize(("before", "after"), [(0.2, 0.9), (0.9, 0.2), (0.5, 0.0)])
def test_the_speed_of_a_rotor_follows_a_step_with_the_mean_of_the_lags(bench, before, after):
    sim = bench({"motors": {"lag_up_s": 0.02, "lag_down_s": 0.06}})
    sim.state[at.THRUST : at.THRUST + 4] = before * 0.327
    for elapsed_s in (0.01, 0.04, 0.2):
        since_s = elapsed_s - sim.sums[at.IMU_TIME]
        run(sim, [after] * 4, since_s)
        share = sqrt(after) + (sqrt(before) - sqrt(after)) * exp(-elapsed_s / 0.04)
        np.testing.assert_allclose(sim.state[at.THRUST : at.THRUST + 4], share**2 * 0.327, rtol=3e-4, atol=1e-6)


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
    np.testing.assert_allclose(sim.state[at.RATES : at.RATES + 3], expected[9:], rtol=1e-4)
    np.testing.assert_allclose(attitude(sim.state), expected[:9].reshape(3, 3), atol=2e-4)


def test_a_tumble_with_a_payload_and_without_air_equals_that_of_the_own_physics(bench):
    """Mass, inertia with its products, and centre of mass; attitude and place all over the sky."""
    ends, commands = [], np.array([0.6, 0.5, 0.52, 0.4])
    for physics in (advance, RotorpyPhysics):
        sim = bench({"initial": {"velocity_ned_m_s": [0.5, -0.3, -4.0]}})
        body = sim.config.body
        set_mass(sim.P, body.mass_kg, body.inertia_kg_m2, (0.0, 0.0, 0.0), ((0.012, (0.03, -0.02, 0.04)),))
        sim.state[10:13] = 9.0, -7.0, 5.0
        sim.state[at.THRUST : at.THRUST + 4] = commands * 0.327  # the laws of the motors differ
        sim.run(commands, 0.8, physics if physics is advance else physics(sim.config))
        ends.append(sim.state[:13].copy())
    np.testing.assert_allclose(ends[1][:10], ends[0][:10], atol=1e-3)
    np.testing.assert_allclose(ends[1][10:], ends[0][10:], atol=1e-2)


def test_the_rotors_and_the_body_drag_in_hover_as_ours_do(bench):
    u = 0.8
    sim = in_hover(bench, [u, 0.0, 0.0])
    assert sim.state[at.VELOCITY] - u == pytest.approx(-(LINEAR + QUADRATIC * u) * u / 0.063 * 0.001, rel=1e-3)
    # the linear part acts at the rotors, the quadratic one at the centre of mass
    assert sim.state[at.RATES + 1] == pytest.approx(LINEAR * u * 0.0159 / 7.16914e-5 * 0.001, rel=1e-3)


def test_the_drag_of_the_rotors_ends_with_their_speed(bench):
    """The own drag has no such law: at rest its linear part remains."""
    sim = bench(DRAG | {"initial": {"position_ned_m": [0, 0, -400], "velocity_ned_m_s": [0.0, 0.0, 11.0]}})
    run(sim, [0] * 4, 6.0)
    assert sim.state[5] == pytest.approx(sqrt(WEIGHT_N / QUADRATIC), rel=1e-5)


def test_the_inflow_of_a_climb_takes_thrust(bench):
    w = 0.5
    sim = in_hover(bench, [0.0, 0.0, -w])
    lost_n = 1.95 * LINEAR * w + QUADRATIC * w * w
    assert sim.state[at.VELOCITY + 2] + w == pytest.approx(lost_n / 0.063 * 0.001, rel=1e-3)


def test_air_in_the_plane_of_the_rotors_adds_thrust(bench):
    u = 1.5
    sim = in_hover(bench, [0.0, u, 0.0], {"lift_s_m": 0.1})
    assert sim.state[at.VELOCITY + 2] == pytest.approx(-0.1 * LINEAR * u * u / 0.063 * 0.001, rel=1e-3)


def test_a_flapping_moment_adds_to_that_of_the_drag(bench):
    u = 0.8
    sim = in_hover(bench, [u, 0.0, 0.0], {"flapping_m": 0.02})
    assert sim.state[at.RATES + 1] == pytest.approx(LINEAR * u * (0.0159 - 0.02) / 7.16914e-5 * 0.001, rel=1e-3)


def test_the_default_ratios_are_those_of_the_hummingbird():
    other = hummingbird.quad_params
    hover = sqrt(other["mass"] * 9.81 / 4 / other["k_eta"])
    ratios = RotorpyConfig()
    assert ratios.inflow_ratio == pytest.approx(other["k_z"] / other["k_d"], rel=1e-3)
    assert ratios.lift_s_m == pytest.approx(other["k_h"] / other["k_d"] / hover, rel=1e-3)
    assert ratios.flapping_m == other["k_flap"]


def test_the_arrays_of_rotorpy_are_turned_about_the_forward_axis(bench):
    """North, east, down becomes north, west, up, and the same for the body. Its position is that of the mass."""
    sim = bench()
    centre = np.array([0.01, -0.02, 0.03])
    set_mass(sim.P, 0.063, (5.8e-5, 7.2e-5, 1e-4), tuple(centre), ())
    sim.state[:3], sim.state[3:6], sim.state[10:13] = (1.0, 2.0, -3.0), (0.1, 0.2, 0.3), (4.0, 5.0, 6.0)
    sim.state[6:10] = np.array([0.3, -0.5, 0.1, 0.8]) / np.linalg.norm([0.3, -0.5, 0.1, 0.8])
    R, body = attitude(sim.state), np.zeros(ROTORPY_SIZE)
    place(sim.state, sim.P, body)
    np.testing.assert_allclose(body[:3], FLIPPED @ (sim.state[:3] + R @ centre), atol=1e-14)
    np.testing.assert_allclose(body[3:6], FLIPPED @ (sim.state[3:6] + R @ np.cross([4, 5, 6], centre)), atol=1e-14)
    np.testing.assert_allclose(
        Rotation.from_quat(body[QUATERNION:RATES]).as_matrix(), FLIPPED @ R @ FLIPPED, atol=1e-14
    )
    np.testing.assert_allclose(body[RATES:WIND], [4.0, -5.0, -6.0])


def test_the_model_has_the_mass_inertia_and_rotors_of_the_parameters():
    config = load_vehicle()
    P = pack_parameters(config)
    set_mass(P, 0.06, (1e-4, 1.5e-4, 2e-4), (0.002, -0.001, 0.003), ((0.02, (0.01, 0.02, 0.03)),))
    vehicle = multirotor.Multirotor(quad_params(P, hover_speed(config), RotorpyConfig()))
    xx, yy, zz, xy, xz, yz = P[at.INERTIA : at.INERTIA + 6]
    J = FLIPPED @ vehicle.inertia @ FLIPPED
    np.testing.assert_allclose(J, [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], rtol=1e-12)
    assert vehicle.mass == pytest.approx(0.08)
    corners = [(1, 1), (-1, -1), (1, -1), (-1, 1)]  # PX4: front right, rear left, front left, rear right
    places = [np.array([0.0441 * x, 0.0441 * y, -0.0159]) - P[at.CENTRE : at.CENTRE + 3] for x, y in corners]
    np.testing.assert_allclose(vehicle.rotor_geometry @ FLIPPED, places, rtol=1e-12)
    force, torque = vehicle.compute_body_wrench(np.zeros(3), np.array([1000.0, 1000.0, 0.0, 0.0]), np.zeros(3))
    assert force[2] == pytest.approx(2 * 4.720e-8 * 1e6)
    assert torque[2] == pytest.approx(-0.003621 * force[2])  # the frame turns against counter-clockwise rotors


def test_agrees_with_the_own_physics_through_all_that_rotorpy_does_not_model(open_loop):
    """Loads, damage, ground effect and payload; without RotorPy's own laws of motors and air."""
    own, _ = open_loop(LOADS, 3, 0.4)
    other, _ = open_loop(LOADS | {"physics": "rotorpy"}, 3, 0.4)
    for name, tolerance in (("position_n", 2e-4), ("velocity_e", 2e-3), ("rate_p", 2e-2), ("quaternion_x", 2e-3)):
        np.testing.assert_allclose(other[:, COLUMN[name]], own[:, COLUMN[name]], atol=tolerance, err_msg=name)
    force = [COLUMN[f"disturbance_force_{axis}"] for axis in "ned"]
    torque = [COLUMN[f"disturbance_torque_{axis}"] for axis in "xyz"]
    np.testing.assert_allclose(other[:, force], own[:, force], atol=4e-3)
    np.testing.assert_allclose(other[:, torque], own[:, torque], atol=1e-4)
    assert np.abs(own[-1, 10:13]).max() > 1.0
    assert not np.array_equal(own, other)


@pytest.mark.parametrize("height_m", [0.05, 2.0])
def test_the_ground_effect_is_ours(bench, height_m):
    ends = []
    for physics in (advance, RotorpyPhysics):
        over = {"initial": {"hovering": True, "position_ned_m": [0, 0, -height_m]}, "floor": {"ground_effect": 11.4}}
        sim = bench(over)
        sim.run([HOVER] * 4, 0.02, physics if physics is advance else physics(sim.config))
        ends.append(sim.state[at.VELOCITY + 2])
    assert ends[1] == pytest.approx(ends[0], rel=1e-3)
    assert (ends[0] < -0.02) == (height_m < 1.0)


def test_stands_still_on_the_floor(bench):
    sim = bench({"initial": {"position_ned_m": None, "yaw_rad": 0.7}})
    run(sim, [0] * 4, 1.0)
    start = sim.state[:13].copy()
    sim.sums[:] = 0.0
    run(sim, [0] * 4, 2.0)
    np.testing.assert_allclose(sim.state[:13], start, atol=1e-7)
    np.testing.assert_allclose(sim.sums[at.IMU_FORCE : at.IMU_FORCE + 3], [0, 0, -2 * GRAVITY], atol=1e-6)
    assert sim.state[2] == pytest.approx(-0.022 + 0.001, abs=1e-4)
    assert sim.state[at.AIRBORNE] == 0


@pytest.mark.parametrize("tilt", [0.0, 0.3, pi - 0.2])
def test_comes_to_rest_after_a_drop(bench, tilt):
    sim = bench({"initial": {"position_ned_m": [0.0, 0.0, -0.2], "velocity_ned_m_s": [0.4, 0.0, 0.0]}})
    sim.state[6:10] = np.cos(tilt / 2), np.sin(tilt / 2), 0.0, 0.0
    run(sim, [0] * 4, 3.0)
    np.testing.assert_allclose(sim.state[3:6], 0.0, atol=1e-3)
    np.testing.assert_allclose(sim.state[10:13], 0.0, atol=1e-2)
    assert -0.03 < sim.state[2] < -0.01
    assert sim.sums[at.TOUCH_SPEED] == pytest.approx(np.sqrt(2 * GRAVITY * 0.17), rel=0.1)


def test_lifts_off_slowly(bench):
    """RotorPy's ground would hold it until it climbs at 1 m/s."""
    sim = bench({"initial": {"position_ned_m": None}})
    sim.state[at.THRUST : at.THRUST + 4] = HOVER * 0.327
    run(sim, [1.05 * HOVER] * 4, 0.3)
    assert sim.state[at.AIRBORNE] == 1
    assert -0.3 < sim.state[at.VELOCITY + 2] < -0.05


def test_a_hard_landing_loses_the_vehicle():
    fall = {"initial": {"position_ned_m": [0.0, 0.0, -0.5]}, "physics": "rotorpy"}
    vehicle = SimVehicle(load_vehicle("mambo", fall), 1)
    vehicle.step(1_000_000_000)
    assert vehicle.crash_reason.startswith("hit the floor at 3.0")


def test_the_same_seed_gives_the_same_flight_however_often_it_is_stepped(open_loop):
    over = LOADS | {"physics": "rotorpy", "disturbances": [*LOADS["disturbances"], SINUSOID]}
    flights = [
        open_loop(over, seed, 0.3, step_ns)[1]
        for seed, step_ns in ((5, 5_000_000), (5, 5_000_000), (5, 1_000_000), (6, 5_000_000))
    ]
    assert flights[0] == flights[1] == flights[2]
    assert flights[0] != flights[3]


def test_a_disturbance_of_the_users_own_acts(tether, open_loop):
    """The tether pulls north with a force that its settings give; it changes little in 0.1 s."""
    over = {"initial": {"position_ned_m": [0.0, 0.0, -1.0], "hovering": True}, "physics": "rotorpy"}
    pulled = {"disturbances": [tether | {"onset_s": 0.0}]}
    north_m = [open_loop(over | more, 1, 0.1)[0][-1, 0] for more in ({}, pulled)]
    force_n = tether["stiffness_n_m"] * (tether["anchor_ned_m"][0] - tether["length_m"])
    assert north_m[1] - north_m[0] == pytest.approx(0.5 * force_n / 0.063 * 0.1**2, rel=0.05)


@pytest.mark.parametrize(
    ("north_m", "east_m", "down_m", "inside"),
    [(0.6, 0.0, -1.0, True), (0.6, 3.0, -1.25, True), (0.6, 0.0, -1.35, False), (0.25, 0.0, -1.0, False)],
)
def test_the_tunnel_blows_along_its_axis_only(open_loop, north_m, east_m, down_m, inside):
    at_place = {"initial": {"position_ned_m": [north_m, east_m, down_m], "hovering": True}, "physics": "rotorpy"}
    truth = open_loop(at_place | {"disturbances": [TUNNEL]}, 1, 0.01, commands=[HOVER] * 4)[0][-1]
    np.testing.assert_allclose(truth[WINDS], [0.0, 4.0 if inside else 0.0, 0.0])
    assert (truth[COLUMN["velocity_e"]] > 1e-3) == inside


def test_the_sinusoid_blows_from_its_onset_to_its_end_on_every_axis(open_loop):
    begun = SINUSOID | {"onset_s": 0.1, "end_s": 0.3, "phase_ned_s": [0.0, 0.1, 0.0]}
    over = {"initial": {"position_ned_m": [0, 0, -2.0], "hovering": True}, "physics": "rotorpy"}
    truths = open_loop(over | {"disturbances": [begun]}, 1, 0.4, commands=[HOVER] * 4)[0]
    for tick, truth in enumerate(truths, start=1):
        since_s = 0.005 * tick - 0.001 - 0.1  # the air of the last sub-step
        blows = 0.0 <= round(since_s, 6) < 0.2
        expected = [1.0, -2.0, 0.5] * np.sin(2 * pi * np.array([2.0, 1.0, 3.0]) * (since_s + np.array([0.0, 0.1, 0.0])))
        np.testing.assert_allclose(truth[WINDS], expected if blows else 0.0, atol=1e-9)


def test_a_wind_of_rotorpy_adds_to_the_others_and_moves_a_cloth(open_loop):
    still = {"initial": {"position_ned_m": [0.6, 0.0, -1.0], "hovering": True}, "physics": "rotorpy"}
    still |= {"drag": {"linear_n_s_m": 0.0, "quadratic_n_s2_m2": 0.0}}
    wind, cloth = {"kind": "wind", "velocity_ned_m_s": [0.0, -1.0, 0.0]}, {"kind": "cloth", "modulation": 0.0}
    truth = open_loop(still | {"disturbances": [wind, cloth, TUNNEL]}, 1, 0.005, commands=[HOVER] * 4)[0][-1]
    assert truth[WINDS[1]] == pytest.approx(3.0)
    assert truth[COLUMN["disturbance_force_e"]] == pytest.approx(0.034, rel=0.02)  # of the cloth at 3 m/s


@pytest.mark.parametrize("physics", ["own", "mujoco"])
@pytest.mark.parametrize(
    ("over", "message"),
    [
        ({"disturbances": [{"kind": "cloth"}, TUNNEL]}, r"disturbances\.1: rotorpy_tunnel needs physics 'rotorpy'"),
        ({"disturbances": [SINUSOID]}, r"disturbances\.0: rotorpy_sinusoid needs physics 'rotorpy'"),
        ({"rotorpy": {"flapping_m": 0.01}}, "rotorpy: its keys need physics 'rotorpy'"),
    ],
)
def test_what_another_physics_would_ignore_is_refused(physics, over, message):
    with pytest.raises(ConfigError, match=f"{message}, not '{physics}'"):
        load_vehicle("mambo", over | {"physics": physics})
    load_vehicle("mambo", over | {"physics": "rotorpy"})


@pytest.mark.parametrize(
    ("tree", "message"),
    [
        (TUNNEL | {"direction_ned": [0.0, 0.0, 0.0]}, "direction_ned: .*has no length"),
        (TUNNEL | {"radius_m": 0.0}, "radius_m: 0.0: .*greater than 0"),
        (SINUSOID | {"frequency_ned_hz": [-1.0, 0.0, 0.0]}, "frequency_ned_hz.0: -1.0: "),
    ],
)
def test_a_wind_that_cannot_blow_is_refused(tree, message):
    with pytest.raises(ConfigError, match=message):
        load_vehicle("mambo", {"physics": "rotorpy", "disturbances": [tree]})


def test_rotors_without_drag_torque_are_refused():
    """RotorPy inverts its map from thrusts to torques; the own physics does not."""
    over = {"motors": {"torque_ratio_m": 0.0}}
    SimVehicle(load_vehicle("mambo", over), 1)
    with pytest.raises(ConfigError, match=r"vehicle\.motors\.torque_ratio_m: RotorPy refuses it: Singular"):
        SimVehicle(load_vehicle("mambo", over | {"physics": "rotorpy"}), 1)


def test_a_batch_has_the_own_physics_only():
    with pytest.raises(ValueError, match="physics"):
        VehicleBatch(load_vehicle("mambo", {"physics": "rotorpy"}), (1, 2))


def test_steps_leave_nothing_to_the_garbage_collection(bench):
    """The process of the vehicle runs without it."""
    sim = bench({"initial": {"hovering": True}})
    physics = RotorpyPhysics(sim.config)
    sim.run([HOVER] * 4, 0.01, physics)
    gc.collect()
    gc.disable()
    try:
        sim.run([HOVER] * 4, 0.1, physics)
        assert gc.collect() < 50
    finally:
        gc.enable()
