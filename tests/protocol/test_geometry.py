"""Laws of quaternions, compared with scipy where possible."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from protocol.geometry import (
    attitude_for_thrust,
    quaternion_multiply,
    quaternion_to_rotation_vector,
    rotate,
    rotation_to_quaternion,
    tilt_angle,
)

SETTINGS = settings(max_examples=100, deadline=None, derandomize=True)
component = st.floats(-1.0, 1.0)
quaternions = (
    st.tuples(component, component, component, component)
    .filter(lambda q: math.hypot(*q) > 0.1)
    .map(lambda q: tuple(x / math.hypot(*q) for x in q))
)
vectors = st.tuples(*[st.floats(-10.0, 10.0)] * 3)


def scipys(q):
    return Rotation.from_quat(q, scalar_first=True)


@SETTINGS
@given(quaternions, quaternions)
def test_the_product_is_the_rotation_after_the_rotation(a, b):
    product = quaternion_multiply(a, b)
    assert math.hypot(*product) == pytest.approx(1.0)
    np.testing.assert_allclose(scipys(product).as_matrix(), (scipys(a) * scipys(b)).as_matrix(), atol=1e-9)


@SETTINGS
@given(quaternions, quaternions, quaternions)
def test_the_product_is_associative_and_conjugation_inverts(a, b, c):
    left = quaternion_multiply(quaternion_multiply(a, b), c)
    np.testing.assert_allclose(left, quaternion_multiply(a, quaternion_multiply(b, c)), atol=1e-12)
    w, x, y, z = a
    np.testing.assert_allclose(quaternion_multiply(a, (w, -x, -y, -z)), (1, 0, 0, 0), atol=1e-12)


@SETTINGS
@given(quaternions, vectors)
def test_rotate_equals_the_matrix(q, v):
    np.testing.assert_allclose(rotate(q, v), scipys(q).apply(v), atol=1e-9)
    assert math.hypot(*rotate(q, v)) == pytest.approx(math.hypot(*v), abs=1e-9)


@SETTINGS
@given(quaternions)
def test_the_rotation_vector_is_the_shorter_way_round(q):
    vector = quaternion_to_rotation_vector(q)
    assert math.hypot(*vector) <= math.pi + 1e-12
    np.testing.assert_allclose(Rotation.from_rotvec(vector).as_matrix(), scipys(q).as_matrix(), atol=1e-9)
    assume(abs(q[0]) > 1e-6)  # at half a turn both directions are equally short
    np.testing.assert_allclose(quaternion_to_rotation_vector(tuple(-x for x in q)), vector, atol=1e-9)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-9, 1e-6, 1.0, math.pi - 1e-9])
def test_the_rotation_vector_is_exact_for_small_and_large_angles(angle):
    q = (math.cos(angle / 2), 0.0, math.sin(angle / 2), 0.0)
    assert quaternion_to_rotation_vector(q) == pytest.approx((0.0, angle, 0.0), rel=1e-9, abs=1e-15)


@SETTINGS
@given(quaternions)
def test_matrix_and_back(q):
    back = rotation_to_quaternion(*scipys(q).as_matrix().ravel())
    assert abs(np.dot(back, q)) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("axis", range(3))
def test_half_turns_have_a_quaternion(axis):
    q = np.zeros(4)
    q[1 + axis] = 1.0
    back = rotation_to_quaternion(*scipys(q).as_matrix().ravel())
    np.testing.assert_allclose(np.abs(back), q, atol=1e-12)


@SETTINGS
@given(st.floats(-1.2, 1.2), st.floats(-math.pi, math.pi), st.floats(-math.pi, math.pi))
def test_attitude_for_thrust_points_down_axis_and_nose(tilt, direction, yaw):
    down = (math.sin(tilt) * math.cos(direction), math.sin(tilt) * math.sin(direction), math.cos(tilt))
    R = scipys(attitude_for_thrust(down, yaw)).as_matrix()
    np.testing.assert_allclose(R[:, 2], down, atol=1e-9)
    # The right wing is perpendicular to the yaw direction, and the nose points along it.
    heading = np.array([math.cos(yaw), math.sin(yaw), 0.0])
    assert abs(R[:, 1] @ heading) < 1e-9
    assert R[:, 0] @ heading > 0.0
    assume(abs(tilt) < 1e-6)
    assert math.atan2(R[1, 0], R[0, 0]) == pytest.approx(yaw, abs=1e-5)


def test_tilt_angle_survives_rounding():
    assert tilt_angle(1.0 + 1e-12) == 0.0
    assert tilt_angle(-1.0 - 1e-12) == pytest.approx(math.pi)
    assert tilt_angle(math.cos(0.3)) == pytest.approx(0.3)
