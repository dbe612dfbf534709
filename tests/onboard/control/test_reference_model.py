"""Hedged reference models: the error obeys its own linear equation, whatever the actuators can deliver."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from onboard.control.reference_model import AttitudeReferenceModel, ChannelGains, PositionReferenceModel

DT = 0.005
GAINS = ChannelGains(natural_frequency_rad_s=(4.0, 4.0, 5.0), damping=0.8)
K1, K2 = GAINS.stiffness(), GAINS.rate_gain()


def position_errors(limit, hedging, delta=0.0, nu=0.0, steps=600):
    """Errors e [n, 6] of a vehicle whose acceleration saturates at `limit`, and what hedging makes of that."""
    model = PositionReferenceModel(GAINS)
    x, v = np.array([1.0, -2.0, 0.5]), np.zeros(3)
    model.reset(x, v)
    errors = []
    for step in range(steps):
        target = np.array([2.0, 1.0, -1.0]) if step > 50 else np.zeros(3)
        u = K1 * (target - x) - K2 * v - nu
        u_hat = np.clip(u, -limit, limit)
        command = u + K1 * x + K2 * v + nu
        model.step(command, u - u_hat if hedging else np.zeros(3), DT)
        a = u_hat + delta
        x = x + DT * v + 0.5 * DT * DT * a
        v = v + DT * a
        errors.append(np.concatenate([model.position - x, model.velocity - v]))
    return np.array(errors)


def test_hedging_keeps_saturation_out_of_the_error():
    """With a wrong nu_ad the error moves, and moves the same however little the actuators can do."""
    free = position_errors(1e6, True, delta=0.7, nu=0.2)
    np.testing.assert_allclose(position_errors(0.5, True, delta=0.7, nu=0.2), free, atol=1e-10)
    np.testing.assert_allclose(position_errors(0.0, True, delta=0.7, nu=0.2), free, atol=1e-10)
    assert np.abs(free[:, :3]).max() > 0.01


def test_without_hedging_saturation_drives_the_error():
    free, held = position_errors(1e6, False, delta=0.7), position_errors(0.5, False, delta=0.7)
    assert np.abs(held - free)[:, :3].max() > 0.5


def test_a_known_plant_has_no_error_at_all():
    np.testing.assert_allclose(position_errors(0.5, True), 0.0, atol=1e-12)


def test_the_error_equation_is_the_one_of_the_law():
    """e_dot = A_rm e + B (nu_ad - Delta): its steady state is K_1^-1 (nu_ad - Delta)."""
    errors = position_errors(0.5, True, delta=0.7, nu=0.2, steps=2000)
    np.testing.assert_allclose(errors[-1, :3], (0.2 - 0.7) / K1, rtol=1e-6)


def test_without_commands_the_position_model_is_the_closed_loop():
    model = PositionReferenceModel(GAINS)
    model.reset(np.array([1.0, 0.0, -1.0]), np.array([0.0, 1.0, 0.0]))
    for _ in range(100):
        model.step(np.zeros(3), np.zeros(3), DT)
    start = np.array([1.0, 0.0, -1.0, 0.0, 1.0, 0.0])
    expected = expm(GAINS.closed_loop_matrix() * 0.5) @ start
    np.testing.assert_allclose(np.concatenate([model.position, model.velocity]), expected, atol=0.02)


def test_a_shift_moves_the_position_alone():
    model = PositionReferenceModel(GAINS)
    model.reset(np.ones(3), np.ones(3))
    model.shift(np.array([0.1, 0.0, -0.2]))
    np.testing.assert_allclose(model.position, [1.1, 1.0, 0.8])
    np.testing.assert_array_equal(model.velocity, 1.0)


# --- attitude --------------------------------------------------------------------------------------------------------


def wxyz(rotation):
    return rotation.as_quat(scalar_first=True)


def spinning(seed, size=1.0):
    """A vehicle's rotation and rates, and a reference near it."""
    rng = np.random.default_rng(seed)
    vehicle, omega = Rotation.random(random_state=seed), rng.normal(size=3) * 4.0
    e1, e2 = rng.normal(size=3) * 0.1 * size, rng.normal(size=3) * size
    turn = Rotation.from_rotvec(e1)
    model = AttitudeReferenceModel(GAINS)
    model.reset(wxyz(vehicle * turn), turn.inv().apply(omega + e2))
    return model, vehicle, omega, e1, e2


@settings(max_examples=50, deadline=None, derandomize=True)
@given(st.integers(0, 2**31 - 1))
def test_the_attitude_error_is_measured_in_the_vehicles_axes(seed):
    model, vehicle, omega, e1, e2 = spinning(seed)
    e = np.zeros(6)
    model.error(wxyz(vehicle), omega, e)
    np.testing.assert_allclose(e, np.concatenate([e1, e2]), atol=1e-9)


def advance_attitude(model, vehicle, omega, u_hat, delta, command, hedge, dt):
    """One small step of a vehicle with omega_dot = u_hat + Delta, and of its reference."""
    e = np.zeros(6)
    model.error(wxyz(vehicle), omega, e)
    model.step(tuple(command), tuple(hedge), dt)
    acceleration = u_hat + delta
    vehicle = vehicle * Rotation.from_rotvec(dt * (omega + 0.5 * dt * acceleration))
    omega = omega + dt * acceleration
    model.error(wxyz(vehicle), omega, e)
    return e


@settings(max_examples=50, deadline=None, derandomize=True)
@given(st.integers(0, 2**31 - 1))
def test_the_attitude_errors_equation_holds_at_any_attitude_and_rate(seed):
    """e_1_dot = e_2 to second order in e, e_2_dot = -K e + nu_ad - Delta, for any u, u_hat and spin."""
    model, vehicle, omega, e1, e2 = spinning(seed)
    rng = np.random.default_rng(seed + 1)
    u, u_hat, nu, delta = rng.normal(size=(4, 3)) * 20.0
    dt = 1e-6
    e = advance_attitude(model, vehicle, omega, u_hat, delta, u + nu, u - u_hat, dt)
    slope = (e - np.concatenate([e1, e2])) / dt
    np.testing.assert_allclose(slope[3:], -K1 * e1 - K2 * e2 + nu - delta, atol=0.01)
    size = np.linalg.norm(e1) * np.linalg.norm(e2)
    assert np.linalg.norm(slope[:3] - e2) <= 0.6 * size + 1e-3


def test_rates_subtracted_in_their_own_axes_would_not_do():
    """The plain difference of body rates misses the term omega x e_1, which does not shrink with e_2."""
    model, vehicle, omega, e1, e2 = spinning(5, 0.1)
    naive = np.array(model.rates) - omega
    e = advance_attitude(model, vehicle, omega, np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), 1e-6)
    slope = (e[:3] - e1) / 1e-6
    assert np.linalg.norm(slope - naive) > 5.0 * np.linalg.norm(slope - e2)


def attitude_errors(limit, hedging, steps=300):
    """Largest |e_1| while a saturating vehicle turns 1.5 rad in roll and 2 rad in yaw, nothing unknown."""
    model = AttitudeReferenceModel(GAINS)
    vehicle, omega, e = Rotation.identity(), np.zeros(3), np.zeros(6)
    model.reset(wxyz(vehicle), omega)
    commanded = Rotation.from_rotvec([1.5, 0.0, 2.0])
    largest = 0.0
    for _ in range(steps):
        turn = (vehicle.inv() * commanded).as_rotvec()
        u = K1 * np.clip(turn, -0.5, 0.5) - K2 * omega
        u_hat = np.clip(u, -limit, limit)
        e = advance_attitude(model, vehicle, omega, u_hat, np.zeros(3), u, u - u_hat if hedging else np.zeros(3), DT)
        vehicle = vehicle * Rotation.from_rotvec(DT * (omega + 0.5 * DT * u_hat))
        omega = omega + DT * u_hat
        largest = max(largest, float(np.linalg.norm(e[:3])))
    return largest


def test_hedging_keeps_saturation_out_of_the_attitude_error():
    assert attitude_errors(1.0, True) < 1e-3
    assert attitude_errors(1.0, False) > 0.3


def test_a_clipped_yaw_error_is_no_disturbance():
    """The reference sees the command the controller really follows, its clipping included."""
    assert attitude_errors(1e9, True) < 1e-3


def test_the_reference_quaternion_keeps_its_length():
    model = AttitudeReferenceModel(GAINS)
    model.reset(np.array([1.0, 0.0, 0.0, 0.0]), np.array([5.0, -7.0, 3.0]))
    for _ in range(2000):
        model.step((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), DT)
    assert math.hypot(*model.quaternion) == pytest.approx(1.0, abs=1e-12)


def test_reset_leaves_no_error():
    model = AttitudeReferenceModel(GAINS)
    q, omega, e = wxyz(Rotation.from_rotvec([0.3, 0.2, -2.0])), np.array([1.0, 2.0, 3.0]), np.ones(6)
    model.reset(q, omega)
    model.error(q, omega, e)
    np.testing.assert_allclose(e, 0.0, atol=1e-15)


def test_poles_are_where_the_gains_say():
    poles = np.linalg.eigvals(GAINS.closed_loop_matrix())
    np.testing.assert_allclose(sorted(np.abs(poles)), [4, 4, 4, 4, 5, 5])
    np.testing.assert_allclose(-poles.real / np.abs(poles), 0.8)


def test_each_axis_has_its_own_damping_and_one_number_stands_for_all() -> None:
    own = ChannelGains(natural_frequency_rad_s=(4.0, 5.0, 6.0), damping=(0.5, 0.7, 1.0))
    np.testing.assert_allclose(own.rate_gain(), [4.0, 7.0, 12.0])
    np.testing.assert_allclose(-np.diag(own.closed_loop_matrix()[3:, 3:]), own.rate_gain())
    assert GAINS.damping == (0.8, 0.8, 0.8)
    with pytest.raises(ValueError, match="damping"):
        ChannelGains(natural_frequency_rad_s=(4.0, 5.0, 6.0), damping=(0.5, 0.1, 1.0))
