"""Laws of mechanics that the compiled step obeys, and an independent integration for comparison."""

from math import pi

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import sim_vehicle.physics.layout as at
from protocol.conventions import GRAVITY
from sim_vehicle.physics.advance import WORK_ROWS, advance
from sim_vehicle.physics.compiled import python_twin
from sim_vehicle.physics.dynamics import rotation
from sim_vehicle.physics.packing import set_mass

PAYLOAD = (0.012, (0.03, -0.02, 0.04))
SIGNS = ((1, 1, 1), (-1, -1, 1), (1, -1, -1), (-1, 1, -1))
"""Front, right, spin of the PX4 motors 1..4."""


def matrix(state):
    return np.array(rotation(*state[6:10])).reshape(3, 3)


def test_hover_balances(bench):
    sim = bench({"initial": {"hovering": True}})
    fraction = 0.063 * GRAVITY / 4 / 0.327
    sim.run([fraction] * 4, 3.0)
    np.testing.assert_allclose(sim.state[:13], [0, 0, -3, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0], atol=1e-12)


def test_free_fall(bench):
    sim = bench()
    sim.run([0] * 4, 0.7)
    assert sim.state[2] == pytest.approx(-3 + 0.5 * GRAVITY * 0.7**2, rel=1e-12)
    assert sim.state[5] == pytest.approx(GRAVITY * 0.7, rel=1e-12)


def test_momentum_and_energy_of_a_free_tumble_with_payload(bench):
    sim = bench({"initial": {"velocity_ned_m_s": [0.5, -0.3, -4.0]}})
    config = sim.config
    set_mass(sim.P, config.body.mass_kg, config.body.inertia_kg_m2, (0.0, 0.0, 0.0), (PAYLOAD,))
    sim.state[10:13] = 9.0, -7.0, 5.0
    m, centre = sim.P[at.MASS], sim.P[at.CENTRE : at.CENTRE + 3].copy()
    xx, yy, zz, xy, xz, yz = sim.P[at.INERTIA : at.INERTIA + 6]
    J = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])

    def conserved(time_s):
        R, w = matrix(sim.state), sim.state[10:13]
        v = sim.state[3:6] + R @ np.cross(w, centre)
        thrown = v - np.array([0, 0, GRAVITY * time_s])
        fall = sim.state[2] + (R @ centre)[2]
        energy = 0.5 * m * v @ v + 0.5 * w @ J @ w - m * GRAVITY * fall
        return np.concatenate([m * thrown, R @ J @ w, [energy]])

    before = conserved(0.0)
    sim.run([0] * 4, 1.0)
    np.testing.assert_allclose(conserved(1.0), before, rtol=1e-7, atol=1e-12)


def test_payload_inertia_is_that_of_two_bodies():
    P = np.zeros(at.PARAMETERS_SIZE)
    set_mass(P, 0.06, (1e-4, 2e-4, 3e-4), (0.0, 0.0, 0.0), ((0.02, (0.0, 0.0, 0.08)),))
    assert P[at.CENTRE + 2] == pytest.approx(0.02)
    reduced = 0.06 * 0.02 / 0.08
    np.testing.assert_allclose(P[at.INERTIA : at.INERTIA + 3], [1e-4 + reduced * 0.0064, 2e-4 + reduced * 0.0064, 3e-4])
    np.testing.assert_allclose(P[at.INVERSE : at.INVERSE + 3] * P[at.INERTIA : at.INERTIA + 3], 1.0)


def test_drag_only_removes_energy(bench):
    sim = bench({"drag": {"linear_n_s_m": 0.016, "quadratic_n_s2_m2": 4.7e-3}})
    sim.state[3:6], sim.state[10:13] = (4.0, -2.0, -3.0), (6.0, 4.0, -8.0)
    J = np.array(sim.config.body.inertia_kg_m2)
    last = np.inf
    for _ in range(60):
        sim.run([0] * 4, 0.01)
        w, v = sim.state[10:13], sim.state[3:6]
        energy = 0.5 * 0.063 * v @ v + 0.5 * w @ (J * w) - 0.063 * GRAVITY * sim.state[2]
        assert energy < last
        last = energy


def test_terminal_speed(bench):
    sim = bench(
        {"drag": {"linear_n_s_m": 0.016, "quadratic_n_s2_m2": 4.7e-3}, "initial": {"position_ned_m": [0, 0, -300]}}
    )
    sim.run([0] * 4, 12.0)
    v = sim.state[5]
    assert 0.016 * v + 4.7e-3 * v * v == pytest.approx(0.063 * GRAVITY, rel=1e-6)


def test_mirror_symmetry(bench):
    """With left and right exchanged, the flight is the mirror image."""
    right, left = bench({"drag": {"linear_n_s_m": 0.02}}), bench({"drag": {"linear_n_s_m": 0.02}})
    right.run([0.5, 0.45, 0.44, 0.52], 0.4)
    left.run([0.44, 0.52, 0.5, 0.45], 0.4)
    sign = np.array([1, -1, 1, 1, -1, 1, 1, -1, 1, -1, -1, 1, -1])
    np.testing.assert_allclose(left.state[:13], sign * right.state[:13], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("commands", "axis", "sign"),
    [
        ((0.5, 0.6, 0.6, 0.5), 10, 1),  # left motors stronger: roll to the right
        ((0.6, 0.5, 0.6, 0.5), 11, 1),  # front motors stronger: nose up
        ((0.6, 0.6, 0.5, 0.5), 12, 1),  # counter-clockwise motors stronger: clockwise from above
    ],
)
def test_signs_of_the_torques(bench, commands, axis, sign):
    sim = bench()
    sim.run(commands, 0.1)
    assert sign * sim.state[axis] > 0.05
    others = [i for i in (10, 11, 12) if i != axis]
    np.testing.assert_allclose(sim.state[others], 0.0, atol=1e-9)


def independent_derivative(t, y, sim, fractions):
    """Newton and Euler for the composite of frame and payload, by a 6 x 6 mass matrix, with a rotation matrix as state.

    y: position 3, velocity 3, R 9, rates 3, thrusts 4.
    """
    config, m_frame, (m_load, r) = sim.config, sim.config.body.mass_kg, PAYLOAD
    r, R, w = np.array(r), y[6:15].reshape(3, 3), y[15:18]
    T = y[18:22]
    target = np.array(fractions) * config.motors.max_thrust_n
    rate = (target - T) / np.where(target > T, config.motors.lag_up_s, config.motors.lag_down_s)
    hub = np.array([0, 0, -config.body.rotor_height_m])
    u = R.T @ y[3:6] + np.cross(w, hub)
    drag = -(config.drag.linear_n_s_m + config.drag.quadratic_n_s2_m2 * np.linalg.norm(u)) * u
    force, torque = R @ drag, np.cross(hub, drag)
    for thrust, (front, right, spin) in zip(T, SIGNS, strict=True):
        place = np.array([front * config.body.arm_x_m, right * config.body.arm_y_m, -config.body.rotor_height_m])
        height = -(y[2] + (R @ place)[2])
        lift = thrust * (1 + config.floor.ground_effect * (config.body.rotor_radius_m / (4 * height)) ** 2)
        force = force + R @ [0, 0, -lift]
        torque = torque + np.cross(place, [0, 0, -lift]) + [0, 0, spin * config.motors.torque_ratio_m * thrust]
    wx = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
    rx = np.array([[0, -r[2], r[1]], [r[2], 0, -r[0]], [-r[1], r[0], 0]])
    J0 = np.diag(config.body.inertia_kg_m2) - m_load * rx @ rx
    m = m_frame + m_load
    M = np.block([[m * np.eye(3), -m_load * rx], [m_load * rx, J0]])
    g = R.T @ [0, 0, GRAVITY]
    right_side = np.concatenate(
        [R.T @ force + m * g - m_load * wx @ wx @ r, torque + m_load * np.cross(r, g) - wx @ J0 @ w]
    )
    a = np.linalg.solve(M, right_side)
    return np.concatenate([y[3:6], R @ a[:3], (R @ wx).ravel(), a[3:], rate])


def test_agrees_with_an_independent_integration(bench):
    sim = bench(
        {
            "drag": {"linear_n_s_m": 0.016, "quadratic_n_s2_m2": 4.7e-3},
            "floor": {"ground_effect": 11.4},
            "initial": {"position_ned_m": [0.0, 0.0, -0.5], "velocity_ned_m_s": [1.0, -0.6, 0.2]},
        }
    )
    set_mass(sim.P, sim.config.body.mass_kg, sim.config.body.inertia_kg_m2, (0.0, 0.0, 0.0), (PAYLOAD,))
    sim.state[10:13] = 0.5, -0.8, 0.3
    y = np.concatenate([sim.state[:6], matrix(sim.state).ravel(), sim.state[10:13], sim.state[13:17]])
    for fractions in ((0.7, 0.72, 0.69, 0.66), (0.55, 0.5, 0.6, 0.52), (0.8, 0.7, 0.75, 0.78)):
        sim.run(fractions, 0.15)
        y = solve_ivp(independent_derivative, (0, 0.15), y, args=(sim, fractions), rtol=1e-10, atol=1e-12).y[:, -1]
    np.testing.assert_allclose(sim.state[:6], y[:6], atol=2e-7)
    np.testing.assert_allclose(matrix(sim.state), y[6:15].reshape(3, 3), atol=2e-6)
    np.testing.assert_allclose(sim.state[10:13], y[15:18], atol=2e-5)
    np.testing.assert_allclose(sim.state[13:17], y[18:22], rtol=1e-8)
    assert np.linalg.norm(sim.state[10:13]) > 1.0


def test_the_step_is_of_fourth_order(bench):
    def end(step_s):
        sim = bench({"drag": {"linear_n_s_m": 0.016, "quadratic_n_s2_m2": 4.7e-3}}, step_s=step_s)
        sim.state[10:13] = 40.0, -30.0, 20.0
        sim.run([0.0] * 4, 0.32)
        return sim.state[:13].copy()

    exact = end(0.00025)
    coarse, fine = (np.linalg.norm(end(step) - exact) for step in (0.008, 0.004))
    assert 10 < coarse / fine < 25


def test_rotation_equals_that_of_scipy(bench):
    q = np.array([0.3, -0.5, 0.1, 0.8])
    R = np.array(rotation(*q)).reshape(3, 3)
    np.testing.assert_allclose(R, Rotation.from_quat(q, scalar_first=True).as_matrix(), atol=1e-14)


def test_rests_on_the_floor(bench):
    sim = bench({"initial": {"position_ned_m": None, "yaw_rad": 0.7}})
    start = sim.state[:13].copy()
    sim.run([0] * 4, 5.0)
    np.testing.assert_allclose(sim.state[:13], start, atol=1e-9)
    assert sim.state[at.AIRBORNE] == 0


@pytest.mark.parametrize("tilt", [0.0, 0.3, pi - 0.2])
def test_comes_to_rest_after_a_drop(bench, tilt):
    """Also on its back: it does not sink into the floor, jitter or slide for ever."""
    sim = bench({"initial": {"position_ned_m": [0.0, 0.0, -0.2], "velocity_ned_m_s": [0.4, 0.0, 0.0]}})
    sim.state[6:10] = np.cos(tilt / 2), np.sin(tilt / 2), 0.0, 0.0
    sim.run([0] * 4, 4.0)
    np.testing.assert_allclose(sim.state[3:6], 0.0, atol=1e-4)
    np.testing.assert_allclose(sim.state[10:13], 0.0, atol=1e-3)
    assert -0.03 < sim.state[2] < -0.01
    assert sim.sums[at.TOUCH_SPEED] == pytest.approx(np.sqrt(2 * GRAVITY * 0.17), rel=0.1)


def test_ground_effect(bench):
    """At a height of 3 R the thrust is 1 + 11.4/144 times that far above the floor."""
    high, low = (bench({"floor": {"ground_effect": 11.4}, "initial": {"hovering": True}}) for _ in range(2))
    low.state[2] = -3 * 0.033 + 0.0159
    for sim in (high, low):
        sim.run([0.063 * GRAVITY / 4 / 0.327] * 4, 0.001)
    assert high.state[at.ACCELERATION + 2] == pytest.approx(0.0, abs=1e-2)
    assert low.state[at.ACCELERATION + 2] == pytest.approx(-GRAVITY * 11.4 / 144, rel=2e-3)


unit = st.floats(-1.0, 1.0)


@settings(max_examples=15, deadline=None)
@given(st.lists(unit, min_size=13, max_size=13), st.lists(st.floats(0.0, 1.0), min_size=4, max_size=4))
def test_compiled_equals_python(numbers, commands):
    """The compiled step equals CPython on the same source: near the floor and above, with all disturbances."""
    from sim_vehicle.config import load_vehicle
    from sim_vehicle.vehicle import initial_state
    from sim_vehicle.world.world import World

    disturbances = [
        {"kind": "wind", "velocity_ned_m_s": [1.0, -2.0, 0.1]},
        {
            "kind": "fan_jet",
            "origin_ned_m": [-2, 0, -1],
            "direction_ned": [1, 0, 0],
            "diameter_m": 0.5,
            "speed_m_s": 6.0,
        },
        {"kind": "gusts", "sigma_m_s": 0.5, "length_scale_m": 0.4},
        {"kind": "cloth"},
        {"kind": "battery_sag"},
        {"kind": "payload", "mass_kg": 0.004, "offset_m": [0.01, 0.02, 0.03]},
        {"kind": "rotor_chip", "thrust_factor": 0.8},
    ]
    config = load_vehicle("mambo", {"disturbances": disturbances})
    results = []
    for function in (advance, python_twin(advance)):
        world = World(config, 3)
        state = initial_state(config)
        state[:13] = np.array(numbers) * [2, 2, 1, 3, 3, 2, 1, 1, 1, 1, 8, 8, 8]
        state[6] += 2.0
        state[6:10] /= np.linalg.norm(state[6:10])
        noise = np.random.default_rng(1).standard_normal((20, len(world.rows), 3))
        sums, work = np.zeros(at.SUMS_SIZE), np.zeros((WORK_ROWS, at.RIGID))
        function(
            state,
            np.array(commands),
            world.condition.parameters,
            world.rows,
            world.memories,
            noise,
            sums,
            work,
            0.25,
            20,
        )
        results.append(np.concatenate([state, sums, world.memories.ravel()]))
    np.testing.assert_allclose(results[0], results[1], rtol=1e-9, atol=1e-12)
