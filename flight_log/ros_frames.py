"""World NED and body FRD, the frames of this project, to world ENU and body FLU, those of ROS (REP 103)."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

_WORLD = Rotation.from_matrix([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
_BODY = Rotation.from_matrix(np.diag([1.0, -1.0, -1.0]))


def world_enu(ned: Array) -> Array:
    """[n, 3] vectors of the world: NED to ENU."""
    return np.column_stack([ned[:, 1], ned[:, 0], -ned[:, 2]])


def body_flu(frd: Array) -> Array:
    """[n, 3] vectors of the body: FRD to FLU."""
    flu: Array = frd * np.array([1.0, -1.0, -1.0])
    return flu


def attitude_enu(wxyz: Array) -> Rotation:
    """[n] rotations from body FLU to world ENU, of [n, 4] quaternions from body FRD to world NED."""
    return _WORLD * Rotation.from_quat(wxyz, scalar_first=True) * _BODY


def xyzw(attitude: Rotation) -> Array:
    """[n, 4] quaternions in the order of ROS messages; the scalar part is not negative."""
    values: Array = attitude.as_quat(canonical=True)
    return values


def arrow_attitude(vectors: Array) -> Rotation:
    """[n] rotations that turn the x axis into the direction of each vector; the identity for a vector of length 0."""
    x = np.array([1.0, 0.0, 0.0])
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    direction = np.where(length > 0.0, vectors / np.maximum(length, 1e-12), x)
    axis = np.cross(x, direction)
    sine = np.linalg.norm(axis, axis=1, keepdims=True)
    axis = np.where(sine > 1e-9, axis / np.maximum(sine, 1e-12), np.array([0.0, 0.0, 1.0]))
    angle = np.arctan2(sine[:, 0], direction[:, 0])
    return Rotation.from_rotvec(axis * angle[:, None])
