"""Motion capture in (MAVLink, one frame per datagram), Pose out.

Accepted: ODOMETRY in a local frame, ATT_POS_MOCAP, and VICON_POSITION_ESTIMATE, which states no frame and is taken as
north-east-down. The capture's clock is mapped to ours by the least delay seen, so that a late datagram keeps the time
at which its pose was true.
"""

from collections import Counter
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import common as mavlink

from offboard.config import PoseRelayConfig
from protocol.messages import Pose

Array = NDArray[np.float64]

FRAME_MAX_BYTES: Final = 280
QUATERNION_TOLERANCE: Final = 0.01
CLOCK_JUMP_NS: Final = 500_000_000
"""An arrival that is later or earlier than expected by more than this means that the capture's clock jumped."""
CLOCK_DRIFT: Final = 1e-4
"""Relative drift of the two clocks that the mapping follows."""
LOCAL_FRAMES: Final = (mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_FRAME_LOCAL_FRD)


class PoseRelay:
    """Decodes the motion capture's datagrams; rubbish is counted by reason in `rejected` and dropped."""

    def __init__(self, config: PoseRelayConfig) -> None:
        self._config = config
        self._codec = mavlink.MAVLink(None)
        self._clock_offset_ns: int | None = None
        self._last_capture_ns: int | None = None
        self._last_arrival_ns = 0
        self.relayed = 0
        self.rejected: Counter[str] = Counter()

    def receive(self, datagram: bytes, now_ns: int) -> Pose | None:
        """The pose a datagram holds, None if it holds none that can be believed."""
        try:
            pose = self._pose(datagram, now_ns)
        except _RejectedError as rejection:
            self.rejected[rejection.reason] += 1
            return None
        self.relayed += 1
        return pose

    def _pose(self, datagram: bytes, now_ns: int) -> Pose:
        message = self._decode(datagram)
        kind = message.get_type()
        if kind == "ODOMETRY":
            if message.frame_id not in LOCAL_FRAMES or message.child_frame_id != mavlink.MAV_FRAME_BODY_FRD:
                raise _RejectedError("frame")
            quaternion = np.array(message.q, dtype=np.float64)
        elif kind == "ATT_POS_MOCAP":
            quaternion = np.array(message.q, dtype=np.float64)
        else:
            quaternion = quaternion_of_euler(message.roll, message.pitch, message.yaw)
        position = np.array([message.x, message.y, message.z], dtype=np.float64)
        time_usec = message.usec if kind == "VICON_POSITION_ESTIMATE" else message.time_usec
        self._check(position, quaternion)
        time_ns = self._map_time(int(time_usec) * 1000, now_ns)
        unit = quaternion / np.linalg.norm(quaternion)
        return Pose(time_ns, position.astype(np.float32), unit.astype(np.float32))

    def _decode(self, datagram: bytes) -> Any:
        if not 0 < len(datagram) <= FRAME_MAX_BYTES:
            raise _RejectedError("length")
        try:
            message = self._codec.decode(bytearray(datagram))
        except (mavlink.MAVError, ValueError, TypeError):  # whatever a peer's bytes make pymavlink raise
            raise _RejectedError("frame_bytes") from None
        if message.get_type() not in ("ODOMETRY", "ATT_POS_MOCAP", "VICON_POSITION_ESTIMATE"):
            raise _RejectedError("message")
        return message

    def _check(self, position: Array, quaternion: Array) -> None:
        if not (np.isfinite(position).all() and np.isfinite(quaternion).all()):
            raise _RejectedError("not_finite")
        if np.abs(position).max() > self._config.position_limit_m:
            raise _RejectedError("too_far")
        if abs(float(np.linalg.norm(quaternion)) - 1.0) > QUATERNION_TOLERANCE:
            raise _RejectedError("quaternion")

    def _map_time(self, capture_ns: int, now_ns: int) -> int:
        """When the pose was true, in our clock; rejects what is older than what was relayed."""
        if self._clock_offset_ns is not None and abs(now_ns - capture_ns - self._clock_offset_ns) > CLOCK_JUMP_NS:
            self._clock_offset_ns = None
            self._last_capture_ns = None
        if self._last_capture_ns is not None and capture_ns <= self._last_capture_ns:
            raise _RejectedError("old")
        delay_ns = now_ns - capture_ns
        if self._clock_offset_ns is None:
            self._clock_offset_ns = delay_ns
        else:
            crept = self._clock_offset_ns + int(CLOCK_DRIFT * (now_ns - self._last_arrival_ns))
            self._clock_offset_ns = min(delay_ns, crept)
        self._last_capture_ns, self._last_arrival_ns = capture_ns, now_ns
        return max(0, capture_ns + self._clock_offset_ns - int(self._config.latency_s * 1e9))


class _RejectedError(Exception):
    """A datagram that holds no pose to relay."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


def quaternion_of_euler(roll: float, pitch: float, yaw: float) -> Array:
    """Quaternion wxyz, body to world, of yaw-pitch-roll angles in rad. [4]"""
    cr, sr = np.cos(roll / 2), np.sin(roll / 2)
    cp, sp = np.cos(pitch / 2), np.sin(pitch / 2)
    cy, sy = np.cos(yaw / 2), np.sin(yaw / 2)
    return np.array(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )
