"""The filter compared with independent computations: rotations, linearisation, delayed corrections."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from onboard.estimation.error_state_filter import ErrorStateFilter
from protocol.conventions import GRAVITY
from protocol.geometry import (
    quaternion_of,
    quaternion_of_rotation_vector,
    rotation_between,
    rotation_of,
    turned_about_vertical,
    unit_product,
)

STEP_NS = 5_000_000
NOISE = (0.3, 0.03, 1e-3, 5e-3)
vectors = st.tuples(*[st.floats(-1.7, 1.7)] * 3)


def moving_filter():
    """A filter after some samples of a turn, whose rate is uncertain."""
    f = ErrorStateFilter(1)
    f.start(quaternion_of(0.2, -0.1, 0.5), (0.0, 0.0, 0.0), (0.1,) * 9 + (0.3,) * 3 + (0.1,) * 3)
    for k in range(40):
        f.predict((k + 1) * STEP_NS, 5e-3, (0.3, -0.2, -9.8), (0.5, -0.8, 0.3), NOISE)
    return f


def scipy_of(q):
    return Rotation.from_quat([q[1], q[2], q[3], q[0]])


@given(vectors, vectors)
def test_rotations_agree_with_scipy(a, b):
    p, q = quaternion_of_rotation_vector(a), quaternion_of_rotation_vector(b)
    np.testing.assert_allclose(np.reshape(rotation_of(p), (3, 3)), Rotation.from_rotvec(a).as_matrix(), atol=1e-9)
    both = scipy_of(p) * scipy_of(q)
    np.testing.assert_allclose(np.reshape(rotation_of(unit_product(p, q)), (3, 3)), both.as_matrix(), atol=1e-9)
    between = Rotation.from_rotvec(rotation_between(p, rotation_of(q)))
    np.testing.assert_allclose((between * scipy_of(q)).as_matrix(), scipy_of(p).as_matrix(), atol=1e-6)


@given(st.floats(-3, 3), st.floats(-1.5, 1.5), st.floats(-3, 3))
def test_euler_angles_agree_with_scipy(roll, pitch, yaw):
    theirs = Rotation.from_euler("ZYX", (yaw, pitch, roll)).as_matrix()
    np.testing.assert_allclose(np.reshape(rotation_of(quaternion_of(roll, pitch, yaw)), (3, 3)), theirs, atol=1e-12)


def test_half_a_turn_and_no_turn():
    level = rotation_of((1.0, 0.0, 0.0, 0.0))
    assert rotation_between((1.0, 0.0, 0.0, 0.0), level) == (0.0, 0.0, 0.0)
    assert math.hypot(*rotation_between((0.0, 0.0, 1.0, 0.0), level)) == pytest.approx(math.pi)
    np.testing.assert_allclose(turned_about_vertical((0.0, 0.0, math.pi / 2), (1.0, 0.0, 3.0)), (0, 1, 3), atol=1e-12)


def flown(rng, samples=40, every=1):
    """A filter after a short random flight, and its samples."""
    f = ErrorStateFilter(every)
    f.start(quaternion_of(0.1, -0.2, 0.5), (0.02, 0.01, -0.03), (0.1,) * 15)
    forces = (rng.normal(0, 2, (samples, 3)) - np.array([0.0, 0.0, GRAVITY])).tolist()
    rates = rng.normal(0, 1, (samples, 3)).tolist()
    inputs = [(tuple(force), tuple(rate)) for force, rate in zip(forces, rates, strict=True)]
    for k, (force, rate) in enumerate(inputs):
        f.predict((k + 1) * STEP_NS, 0.005, force, rate, NOISE)
    return f, inputs


def perturbed(f, error):
    """The truth for an estimate with this error."""
    return (
        np.array(f.position) + error[0:3],
        np.array(f.velocity) + error[3:6],
        Rotation.from_rotvec(error[6:9]).as_matrix() @ np.reshape(f.rotation, (3, 3)),
        np.array(f.gyro_bias) + error[9:12],
        np.array(f.accelerometer_bias) + error[12:15],
    )


def test_the_transition_matrix_is_the_derivative_of_the_equations():
    """A small error follows Phi in the nonlinear equations."""
    rng = np.random.default_rng(1)
    f, _ = flown(rng)
    small = 1e-5 * rng.standard_normal(15)
    p, v, R, bg, ba = perturbed(f, small)
    twin = ErrorStateFilter(1)
    twin.start(tuple(Rotation.from_matrix(R).as_quat()[[3, 0, 1, 2]]), tuple(bg), (0.1,) * 15)
    twin.position, twin.velocity, twin.accelerometer_bias = tuple(p), tuple(v), tuple(ba)
    force, rate = (0.5, -1.0, -9.0), (0.4, -0.3, 0.8)
    f._last_rate = twin._last_rate = rate
    for one in (f, twin):
        one.predict(10**9, 0.005, force, rate, NOISE)
    after = np.concatenate(
        (
            np.subtract(twin.position, f.position),
            np.subtract(twin.velocity, f.velocity),
            rotation_between(twin.quaternion, f.rotation),
            np.subtract(twin.gyro_bias, f.gyro_bias),
            np.subtract(twin.accelerometer_bias, f.accelerometer_bias),
        )
    )
    np.testing.assert_allclose(after, f._Phi @ small, atol=2e-8)


def test_covariance_over_several_samples_is_that_of_single_samples():
    """Collecting four samples before one covariance step changes standard deviations by less than two percent."""
    single, _ = flown(np.random.default_rng(2), every=1)
    gathered, _ = flown(np.random.default_rng(2), every=4)
    np.testing.assert_allclose(np.sqrt(np.diag(gathered.P)), np.sqrt(np.diag(single.P)), rtol=0.02)


def test_covariance_of_a_hover_agrees_with_the_continuous_equations():
    """P(t) of the linear system at hover, by the matrix exponential (Van Loan 1978)."""
    f = ErrorStateFilter(2)
    f.start((1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), tuple(np.linspace(0.01, 0.15, 15)))
    P0 = f.P.copy()
    for k in range(400):
        f.predict((k + 1) * STEP_NS, 0.005, (0.0, 0.0, -GRAVITY), (0.0, 0.0, 0.0), NOISE)
    F, Q = np.zeros((15, 15)), np.zeros((15, 15))
    F[0:3, 3:6] = np.eye(3)
    F[3:6, 6:9] = -np.array([[0, GRAVITY, 0], [-GRAVITY, 0, 0], [0, 0, 0]])
    F[3:6, 12:15] = F[6:9, 9:12] = -np.eye(3)
    for block, density in ((3, 0.3**2 * 0.005), (6, 0.03**2 * 0.005), (9, 1e-3**2), (12, 5e-3**2)):
        Q[block : block + 3, block : block + 3] = density * np.eye(3)
    van_loan = expm(np.block([[-F, Q], [np.zeros((15, 15)), F.T]]) * 2.0)
    Phi = van_loan[15:, 15:].T
    P = Phi @ P0 @ Phi.T + Phi @ van_loan[:15, 15:]
    np.testing.assert_allclose(np.sqrt(np.diag(f.P)), np.sqrt(np.diag(P)), rtol=0.03)


def test_rounding_adds_up_to_nothing():
    """An antisymmetric part of P, which no correction reduces, is gone after a prediction."""
    f = moving_filter()
    f.P[9, 6] += 1e-9
    f.P[6, 9] -= 1e-9
    f.predict(41 * STEP_NS, 5e-3, (0.3, -0.2, -9.8), (0.5, -0.8, 0.3), NOISE)
    np.testing.assert_array_equal(f.P, f.P.T)


def test_in_a_long_flight_with_gaps_of_the_poses_the_covariance_stays_positive():
    """13 minutes in steps of 0.2 s: flow and range throughout, and poses but for three gaps."""
    f = ErrorStateFilter(1)
    f.start((1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.02,) * 3 + (0.05,) * 6 + (0.02,) * 3 + (0.35,) * 3)
    dt, least, skew = 0.2, math.inf, 0.0
    for k in range(round(800.0 / dt)):
        t = k * dt
        force = (-0.2 * GRAVITY * math.sin(t), -0.3 * GRAVITY * math.sin(0.7 * t), -GRAVITY)
        rate = (0.05 * math.cos(0.7 * t), 0.05 * math.cos(t), 0.02 * math.cos(0.3 * t))
        f.predict(round(t * 1e9), dt, force, rate, (1.0, 0.01, 1e-3, 5e-3))
        if not (100.0 < t < 220.0 or 300.0 < t < 330.0 or 400.0 < t < 430.0):
            f.correct_position((0.0, 0.0, 0.0), 0.012, 2.5e-7, math.inf)
            f.correct_attitude((0.0, 0.0, 0.0), 2.5e-5, math.inf)
        for index, variance in ((3, 6.4e-3), (4, 6.4e-3), (2, 4.4e-4)):
            f.correct_scalar(index, 0.0, variance, math.inf)
        if k % 100 == 99:
            least = min(least, float(np.linalg.eigvalsh(0.5 * (f.P + f.P.T))[0]))
            skew = max(skew, float(np.abs(f.P - f.P.T).max()))
    assert least > 0.0
    assert skew < 1e-14


def test_later_corrections_apply_to_past_states():
    """Later corrections of position and velocity apply to a stored state by the equations of motion."""
    rng = np.random.default_rng(3)
    f, inputs = flown(rng)
    twin = ErrorStateFilter(1)
    twin.start(quaternion_of(0.1, -0.2, 0.5), (0.02, 0.01, -0.03), (0.1,) * 15)
    before_s = 15 * 0.005
    dp, dv = np.array([0.3, -0.1, 0.05]), np.array([0.2, 0.1, -0.1])
    f.shift(tuple(dp), tuple(dv), (0.0, 0.0, 0.0))
    past = f.at(25 * STEP_NS)
    for k in range(25):
        twin.predict((k + 1) * STEP_NS, 0.005, *inputs[k], NOISE)
    np.testing.assert_allclose(past.velocity, twin.velocity + dv, atol=1e-9)
    np.testing.assert_allclose(past.position, twin.position + dp - dv * before_s, atol=1e-9)
    turn = (0.002, -0.001, 0.003)
    f.shift((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), turn)
    past = f.at(25 * STEP_NS)
    theirs = Rotation.from_rotvec(turn).as_matrix() @ np.reshape(twin.rotation, (3, 3))
    np.testing.assert_allclose(np.reshape(past.rotation, (3, 3)), theirs, atol=1e-5)


def test_between_samples_the_past_state_moves_on():
    f, _ = flown(np.random.default_rng(4))
    at, between = f.at(20 * STEP_NS), f.at(20 * STEP_NS + 2_000_000)
    np.testing.assert_allclose(between.position, np.array(at.position) + 0.002 * np.array(at.velocity), atol=1e-12)
    moved = Rotation.from_rotvec(0.002 * np.array(at.rate_world)).as_matrix() @ np.reshape(at.rotation, (3, 3))
    np.testing.assert_allclose(np.reshape(between.rotation, (3, 3)), moved, atol=1e-4)


def test_history_is_bounded_and_can_be_forgotten():
    f, _ = flown(np.random.default_rng(5), samples=300)
    assert f.at(300 * STEP_NS) is not None
    assert f.at(180 * STEP_NS) is not None
    assert f.at(100 * STEP_NS) is None
    assert f.at(0) is None
    f.forget_history()
    assert f.at(300 * STEP_NS) is None


@pytest.mark.parametrize("delay_s", [0.0, 0.08])
def test_corrections_are_those_of_the_textbook(delay_s):
    """Gain and covariance of each correction, compared with the matrix formula."""
    rng = np.random.default_rng(6)
    f, _ = flown(rng)
    y = np.array([0.02, -0.01, 0.03])
    H = np.zeros((3, 15))
    H[:, 0:3], H[:, 3:6] = np.eye(3), -delay_s * np.eye(3)
    P = f.P.copy()
    S = H @ P @ H.T + 1e-3 * np.eye(3)
    K = P @ H.T @ np.linalg.inv(S)
    before = np.concatenate((f.position, f.velocity, f.gyro_bias, f.accelerometer_bias))
    score = f.correct_position(tuple(y), delay_s, 1e-3, math.inf)
    assert score == pytest.approx(y @ np.linalg.solve(S, y))
    np.testing.assert_allclose(f.P, P - K @ H @ P, atol=1e-10)
    error = (K @ y)[[*range(6), *range(9, 15)]]
    after = np.concatenate((f.position, f.velocity, f.gyro_bias, f.accelerometer_bias))
    np.testing.assert_allclose(after - before, error, atol=1e-10)


def test_a_measurement_outside_the_gate_changes_nothing():
    f, _ = flown(np.random.default_rng(7))
    P, position = f.P.copy(), f.position
    assert f.correct_scalar(0, 50.0, 1e-4, 9.0) > 9.0
    assert f.correct_position((9.0, 9.0, 9.0), 0.0, 1e-4, 25.0) > 25.0
    assert f.correct_attitude((2.0, 0.0, 0.0), 1e-4, 25.0) > 25.0
    np.testing.assert_array_equal(f.P, P)
    assert f.position == position


def test_scalar_corrections_by_index_and_by_row_agree():
    one, _ = flown(np.random.default_rng(8))
    two, _ = flown(np.random.default_rng(8))
    h = np.zeros(15)
    h[4] = 1.0
    assert one.correct_scalar(4, 0.1, 0.01, 99.0) == pytest.approx(two.correct_scalar(h, 0.1, 0.01, 99.0))
    np.testing.assert_allclose(one.P, two.P, atol=1e-14)
    assert one.velocity == pytest.approx(two.velocity)


def test_a_velocity_that_may_have_been_wrong_for_a_while_is_found_by_a_position():
    """After inflation along (T v, v), a velocity that was wrong for T s explains an innovation of 1 cm."""
    f, _ = flown(np.random.default_rng(1))
    f.restart_error(0, 1e-4)
    f.restart_error(3, 1e-4)
    before = f.velocity
    f.inflate_motion(5.0, 0.03)
    assert np.linalg.eigvalsh(f.P).min() > -1e-12
    f.correct_position((0.01, 0.0, 0.0), 0.01, 1e-8, math.inf)
    assert f.velocity[0] - before[0] == pytest.approx(0.01 / 0.02, rel=0.01)


def test_a_past_attitude_corrects_the_rate_as_the_kalman_equations_say():
    """H = [0, 0, I, tau R, 0], with the covariances of some samples."""
    f = moving_filter()
    R, tau, sigma = np.reshape(f.rotation, (3, 3)), 0.02, 0.01
    H = np.zeros((3, 15))
    H[:, 6:9], H[:, 9:12] = np.eye(3), tau * R
    y = np.array([0.02, -0.01, 0.03])
    S = H @ f.P @ H.T + sigma**2 * np.eye(3)
    K = f.P @ H.T @ np.linalg.inv(S)
    bias, P = np.array(f.gyro_bias), f.P.copy()
    score = f.correct_past_attitude(tuple(y), tau, sigma**2, math.inf)
    assert score == pytest.approx(y @ np.linalg.solve(S, y))
    np.testing.assert_allclose(f.gyro_bias, bias + (K @ y)[9:12], rtol=1e-9)
    np.testing.assert_allclose(f.P, P - K @ H @ P, atol=1e-12)
