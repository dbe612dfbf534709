"""Frames and rotations for controllers of one's own: world NED, body FRD, quaternions wxyz from body to world."""

from protocol.conventions import GRAVITY
from protocol.geometry import (
    Quaternion,
    Vector3,
    attitude_for_thrust,
    quaternion_multiply,
    quaternion_to_rotation_vector,
    roll_pitch_yaw,
    rotate,
)

__all__ = [
    "GRAVITY",
    "Quaternion",
    "Vector3",
    "attitude_for_thrust",
    "quaternion_multiply",
    "quaternion_to_rotation_vector",
    "roll_pitch_yaw",
    "rotate",
]
