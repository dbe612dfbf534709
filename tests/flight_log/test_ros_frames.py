"""The frames of ROS: known attitudes, and vectors there and back."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from flight_log.ros_frames import arrow_attitude, attitude_enu, body_flu, world_enu, xyzw

EAST, NORTH, UP = np.eye(3)
FORWARD, LEFT, ABOVE = np.eye(3)


def of(*euler_deg: float) -> Rotation:
    """The attitude in ROS frames of yaw, pitch and roll, deg, in NED and FRD."""
    wxyz = Rotation.from_euler("ZYX", euler_deg, degrees=True).as_quat(scalar_first=True)
    return attitude_enu(wxyz[None])[0]


@pytest.mark.parametrize(
    ("euler_deg", "axis", "points"),
    [
        ((0, 0, 0), FORWARD, NORTH),
        ((0, 0, 0), LEFT, -EAST),
        ((0, 0, 0), ABOVE, UP),
        ((90, 0, 0), FORWARD, EAST),
        ((0, 90, 0), FORWARD, UP),
        ((0, 0, 90), LEFT, UP),
    ],
)
def test_a_known_attitude(euler_deg: tuple[float, ...], axis: np.ndarray, points: np.ndarray) -> None:
    np.testing.assert_allclose(of(*euler_deg).apply(axis), points, atol=1e-12)


def test_a_vector_of_the_body_is_the_same_vector_of_the_world() -> None:
    rng = np.random.default_rng(1)
    quaternion = Rotation.random(20, rng=rng).as_quat(scalar_first=True)
    frd = rng.normal(size=(20, 3))
    ned = Rotation.from_quat(quaternion, scalar_first=True).apply(frd)
    np.testing.assert_allclose(attitude_enu(quaternion).apply(body_flu(frd)), world_enu(ned), atol=1e-12)
    assert (xyzw(attitude_enu(quaternion))[:, 3] >= 0.0).all()


def test_an_arrow_points_along_its_vector() -> None:
    vectors = np.array([[1.0, 2.0, -3.0], [-2.0, 0.0, 0.0], [5.0, 0.0, 0.0], [0.0, 0.0, 0.1]])
    turned = arrow_attitude(vectors).apply(np.array([1.0, 0.0, 0.0]))
    np.testing.assert_allclose(turned, vectors / np.linalg.norm(vectors, axis=1, keepdims=True), atol=1e-9)
    np.testing.assert_allclose(arrow_attitude(np.zeros((1, 3))).magnitude(), 0.0)
