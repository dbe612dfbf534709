"""Motion capture to offboard: the vehicle's pose, world NED, quaternion wxyz body FRD to world.

ODOMETRY in a local frame, ATT_POS_MOCAP, or VICON_POSITION_ESTIMATE. The last two state no frame and are taken as NED.
The simulated motion capture sends ODOMETRY.
"""

from collections.abc import Callable
from math import isfinite, nan
from typing import Final, NamedTuple

from pymavlink.dialects.v20 import common as mavlink

from protocol.geometry import Quaternion, Vector3, quaternion_of
from protocol.mavlink.frames import Fields, FixedFields, Message
from protocol.named_tuple import of_members

FRAME_BYTES_MAX: Final = 280
_LOCAL_FRAMES: Final = (mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_FRAME_LOCAL_FRD)
_SENT: Final = (mavlink.MAV_FRAME_LOCAL_FRD, mavlink.MAV_FRAME_BODY_FRD, 0, mavlink.MAV_ESTIMATOR_TYPE_MOCAP, 100)
"""ODOMETRY's last fields: frames, resets, estimator, quality in per cent."""
_UNKNOWN_RATE_VARIANCE: Final = 1.0e4
"""(rad/s)^2: motion capture measures no rates."""


class CapturedPose(NamedTuple):
    """A pose as received: not checked, the numbers may be infinite or NaN."""

    time_ns: int
    """The motion capture's clock."""
    position_ned_m: Vector3
    quaternion: Quaternion


_captured: Final = of_members(CapturedPose)
_message: Final = of_members(Message)


def odometry_covariances(position_variance: float, attitude_variance: float, velocity_variance: float) -> FixedFields:
    """ODOMETRY's two covariances, m^2, rad^2 and (m/s)^2 per axis: upper triangles of diagonal 6 x 6 matrices.

    Behind them, the fields that are always the same.
    """
    pose = (position_variance,) * 3 + (attitude_variance,) * 3
    covariances = (*_triangle(pose), *_triangle((velocity_variance,) * 3 + (_UNKNOWN_RATE_VARIANCE,) * 3))
    return FixedFields(mavlink.MAVLink_odometry_message, (*covariances, *_SENT))


def _triangle(diagonal: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(value if column == row else 0.0 for row, value in enumerate(diagonal) for column in range(row, 6))


def encode_odometry(
    time_us: int, position_ned_m: Vector3, quaternion: Quaternion, velocity_body_m_s: Vector3, covariances: FixedFields
) -> Message:
    """ODOMETRY: pose in LOCAL_FRD (here the same as NED), velocity in BODY_FRD, no rates."""
    fields = (time_us, *position_ned_m, *quaternion, *velocity_body_m_s, 0.0, 0.0, 0.0)
    return _message((mavlink.MAVLink_odometry_message, fields, covariances))


def _decode_odometry(f: Fields) -> CapturedPose | None:
    # time_usec, position 3, quaternion 4, six rates, two covariances of 21, frame_id, child_frame_id, ...
    if f[56] not in _LOCAL_FRAMES or f[57] != mavlink.MAV_FRAME_BODY_FRD:
        return None
    return _captured((f[0] * 1000, f[1:4], f[4:8]))


def _decode_att_pos_mocap(f: Fields) -> CapturedPose:
    # time_usec, quaternion 4, position 3
    return CapturedPose(f[0] * 1000, f[5:8], f[1:5])


def _decode_vicon(f: Fields) -> CapturedPose:
    # usec, position 3, roll, pitch, yaw (rad)
    finite = isfinite(f[4] + f[5] + f[6])
    return CapturedPose(f[0] * 1000, f[1:4], quaternion_of(f[4], f[5], f[6]) if finite else (nan,) * 4)


DECODERS: Final[dict[int, Callable[[Fields], CapturedPose | None]]] = {
    mavlink.MAVLINK_MSG_ID_ODOMETRY: _decode_odometry,
    mavlink.MAVLINK_MSG_ID_ATT_POS_MOCAP: _decode_att_pos_mocap,
    mavlink.MAVLINK_MSG_ID_VICON_POSITION_ESTIMATE: _decode_vicon,
}
"""By message id. The result is None if the frames are not a local world frame and body FRD."""
