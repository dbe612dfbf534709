"""Rotations: each function of protocol/geometry.py and its twin in C."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.c.library import Core
from protocol import geometry
from tests.onboard.c.parity import SETTINGS, call, numbers, quaternions, same, vectors

TWINS = {"vector_cross": "cross", "vector_add": "add", "vector_subtract": "subtract"}


@pytest.mark.parametrize("name", TWINS)
@SETTINGS
@given(a=vectors(3, 10.0), b=vectors(3, 10.0))
def test_of_two_vectors(core: Core, name: str, a: list[float], b: list[float]) -> None:
    same(call(core, name, a, b, out=3), getattr(geometry, TWINS[name])(tuple(a), tuple(b)), scale=1.0)


@SETTINGS
@given(a=quaternions(), b=quaternions(), v=vectors(3, 10.0), factor=numbers(5.0))
def test_of_quaternions_and_vectors(core: Core, a: list[float], b: list[float], v: list[float], factor: float) -> None:
    q, p, u = tuple(a), tuple(b), tuple(v)
    R = geometry.rotation_of(q)
    same(call(core, "quaternion_multiply", a, b, out=4), geometry.quaternion_multiply(q, p))
    same(call(core, "unit_product", a, b, out=4), geometry.unit_product(q, p))
    same(call(core, "quaternion_conjugate", a, out=4), (q[0], -q[1], -q[2], -q[3]))
    same(call(core, "rotate", a, v, out=3), geometry.rotate(q, u), scale=1.0)
    same(call(core, "matrix_times", R, v, out=3), geometry.matrix_times(R, u), scale=1.0)
    same(call(core, "vector_scale", v, factor, out=3), geometry.scale(u, factor))
    same(call(core, "vector_copy", v, out=3), u)
    same(call(core, "vector_zero", out=3), geometry.ZERO)
    same(call(core, "turned_about_vertical", v, a[:3], out=3), geometry.turned_about_vertical(u, q[:3]), scale=1.0)
    assert core.vector_squared_length(np.array(v)) == geometry.squared_length(u)
    assert core.vector_length(np.array(v)) == pytest.approx(math.hypot(*u), rel=1e-15)


@SETTINGS
@given(a=quaternions(), b=quaternions())
def test_of_rotations(core: Core, a: list[float], b: list[float]) -> None:
    q, R = tuple(a), geometry.rotation_of(tuple(b))
    same(call(core, "rotation_of", b, out=9), R)
    same(call(core, "rotation_to_quaternion", R, out=4), geometry.rotation_to_quaternion(*R))
    same(call(core, "quaternion_to_rotation_vector", a, out=3), geometry.quaternion_to_rotation_vector(q))
    same(call(core, "rotation_between", a, R, out=3), geometry.rotation_between(q, R), scale=1.0)
    same(call(core, "euler_of", R, out=3), geometry.euler_of(R), scale=1.0)
    assert core.tilt_angle(R[8]) == pytest.approx(geometry.tilt_angle(R[8]), rel=1e-14)


@SETTINGS
@given(roll=numbers(3.2), pitch=numbers(1.6), yaw=numbers(3.2), phi=vectors(3, 3.0), size=st.sampled_from([1.0, 1e-7]))
def test_of_angles(core: Core, roll: float, pitch: float, yaw: float, phi: list[float], size: float) -> None:
    same(call(core, "quaternion_of", roll, pitch, yaw, out=4), geometry.quaternion_of(roll, pitch, yaw))
    phi = [size * x for x in phi]
    same(call(core, "quaternion_of_rotation_vector", phi, out=4), geometry.quaternion_of_rotation_vector((*phi,)))


@SETTINGS
@given(tilt=numbers(1.2), towards=numbers(3.2), yaw=numbers(3.2))
def test_attitude_for_thrust(core: Core, tilt: float, towards: float, yaw: float) -> None:
    down = (math.sin(tilt) * math.cos(towards), math.sin(tilt) * math.sin(towards), math.cos(tilt))
    same(call(core, "attitude_for_thrust", down, yaw, out=4), geometry.attitude_for_thrust(down, yaw))


def test_every_branch_of_shepperds_method(core: Core) -> None:
    for q in np.eye(4) + 0.01:
        R = geometry.rotation_of(tuple(q / np.linalg.norm(q)))
        same(call(core, "rotation_to_quaternion", R, out=4), geometry.rotation_to_quaternion(*R))


def test_no_rotation_and_half_a_turn_between(core: Core) -> None:
    upright = geometry.rotation_of((1.0, 0.0, 0.0, 0.0))
    for measured in ((1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0)):
        same(call(core, "rotation_between", measured, upright, out=3), geometry.rotation_between(measured, upright))


def test_the_result_may_overwrite_an_input(core: Core) -> None:
    a, b = np.array([0.5, 0.5, -0.5, 0.5]), np.array([0.1, 0.7, 0.7, 0.1])
    for name, of in (("quaternion_multiply", geometry.quaternion_multiply), ("unit_product", geometry.unit_product)):
        first, second = a.copy(), b.copy()
        getattr(core, name)(first, b, first)
        getattr(core, name)(a, second, second)
        same(first, of((*a,), (*b,)))
        same(second, of((*a,), (*b,)))
    v = b[:3].copy()
    core.rotate(a, v, v)
    same(v, geometry.rotate((*a,), (*b[:3],)))
