"""Motion capture in (MAVLink, one frame per datagram), Pose out.

Accepted: ODOMETRY in a local frame, ATT_POS_MOCAP, and VICON_POSITION_ESTIMATE, which states no frame and is taken as
north-east-down. The capture's clock is mapped to ours by the least delay seen, so that a late datagram keeps the time
at which its pose was true. A capture that has lost the vehicle may repeat the last pose with fresh times: then nothing
is relayed, and onboard sees the pose grow old.
"""

from collections import Counter, deque
from collections.abc import Callable
from math import cos, hypot, isfinite, nan, sin
from typing import Any, Final

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from offboard.config import PoseRelayConfig
from protocol.geometry import Quaternion, Vector3
from protocol.mavlink_frames import Frame, FrameReader
from protocol.messages import Pose

FRAME_MAX_BYTES: Final = 280
QUATERNION_TOLERANCE: Final = 0.01
CLOCK_JUMP_NS: Final = 500_000_000
"""An arrival that is later or earlier than expected by more than this means that the capture's clock jumped."""
LATE_NS: Final = 50_000_000
"""A pose later than expected by more than this is not relayed: it was held up, or a clock has jumped."""
LATE_POSES_MAX: Final = 50
LATE_SPREAD_NS: Final = 20_000_000
"""So many poses in a row, all late by the same time within this spread, were not held up: a clock has jumped."""
FROZEN_POSES: Final = 10
"""So many poses in a row that are the same to the last bit are no measurements."""
CLOCK_DRIFT: Final = 1e-4
"""Relative drift of the two clocks that the mapping follows."""
SAY_EVERY_NS: Final = 10**9
"""What is wrong is said no oftener than this, each reason for itself."""
TROUBLES: Final = {
    "length": "datagram of a wrong length",
    "message": "message that holds no pose",
    "frame_bytes": "spoilt frame, or several in one datagram",
    "frame": "frame is not local north-east-down with body forward-right-down",
    "not_finite": "gave nan or infinity",
    "too_far": "position beyond position_limit_m",
    "quaternion": "quaternion's length is not 1",
    "old": "time does not go forward",
    "late": "comes late",
    "frozen": "frozen: repeats one pose",
}
"""Reasons in words."""
LOCAL_FRAMES: Final = (mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_FRAME_LOCAL_FRD)


class PoseRelay:
    """Decodes the motion capture's datagrams; rubbish is counted by reason in `rejected` and dropped."""

    def __init__(self, config: PoseRelayConfig) -> None:
        self._config = config
        self._reader = FrameReader(_CONTENTS)
        self._clock_offset_ns: int | None = None
        self._last_capture_ns: int | None = None
        self._last_arrival_ns = 0
        self._late: deque[int] = deque(maxlen=LATE_POSES_MAX)
        self._last_place: tuple[Vector3, Quaternion] | None = None
        self._same = 0
        self._said_ns: dict[str, int] = {}
        self._events: list[tuple[int, str]] = []
        self.relayed = 0
        self.rejected: Counter[str] = Counter()

    def receive(self, datagram: bytes, now_ns: int) -> Pose | None:
        """The pose a datagram holds, None if it holds none that can be believed."""
        try:
            pose = self._pose(datagram, now_ns)
        except _RejectedError as rejection:
            self.rejected[rejection.reason] += 1
            self._say(rejection.reason, now_ns)
            return None
        self.relayed += 1
        return pose

    def take_events(self) -> list[tuple[int, str]]:
        """What was wrong since the last call: (time_ns, text)."""
        events, self._events = self._events, []
        return events

    def _say(self, reason: str, now_ns: int) -> None:
        if now_ns - self._said_ns.get(reason, -SAY_EVERY_NS) >= SAY_EVERY_NS:
            self._said_ns[reason] = now_ns
            self._events.append((now_ns, f"motion capture: {TROUBLES[reason]}, pose ignored"))

    def _pose(self, datagram: bytes, now_ns: int) -> Pose:
        frame = self._frame(datagram, now_ns)
        time_us, position, quaternion = _CONTENTS[frame.message_id](frame.fields)
        norm = self._checked_norm(position, quaternion)
        time_ns = self._map_time(time_us * 1000, now_ns)
        self._require_life(position, quaternion)
        w, x, y, z = quaternion
        unit = (w / norm, x / norm, y / norm, z / norm)
        return Pose(time_ns, np.array(position, dtype=np.float32), np.array(unit, dtype=np.float32))

    def _frame(self, datagram: bytes, now_ns: int) -> Frame:
        """The one frame of a datagram."""
        if not 0 < len(datagram) <= FRAME_MAX_BYTES:
            raise _RejectedError("length")
        frames = self._reader.read(datagram, now_ns)
        if len(frames) != 1:
            others = self._reader.rejected.pop("message_not_allowed", 0)
            raise _RejectedError("message" if others else "frame_bytes")
        return frames[0]

    def _checked_norm(self, position: Vector3, quaternion: Quaternion) -> float:
        """Length of the quaternion, once both are found to be sensible."""
        n, e, d = position
        norm = hypot(*quaternion)
        if not isfinite(n + e + d + norm):
            raise _RejectedError("not_finite")
        if max(abs(n), abs(e), abs(d)) > self._config.position_limit_m:
            raise _RejectedError("too_far")
        if abs(norm - 1.0) > QUATERNION_TOLERANCE:
            raise _RejectedError("quaternion")
        return norm

    def _require_life(self, position: Vector3, quaternion: Quaternion) -> None:
        """Rejects a pose that has come unchanged too often."""
        place = position, quaternion
        self._same = self._same + 1 if place == self._last_place else 0
        self._last_place = place
        if self._same >= FROZEN_POSES:
            raise _RejectedError("frozen")

    def _map_time(self, capture_ns: int, now_ns: int) -> int:
        """When the pose was true, in our clock; rejects what is older than what was relayed."""
        if self._clock_offset_ns is not None and abs(now_ns - capture_ns - self._clock_offset_ns) > CLOCK_JUMP_NS:
            self._clock_offset_ns = None
            self._last_capture_ns = None
        if self._last_capture_ns is not None and capture_ns <= self._last_capture_ns:
            raise _RejectedError("old")
        delay_ns = now_ns - capture_ns
        if self._clock_offset_ns is not None and delay_ns - self._clock_offset_ns > LATE_NS:
            self._require_jump(delay_ns)
        self._late.clear()
        if self._clock_offset_ns is None:
            self._clock_offset_ns = delay_ns
        else:
            crept = self._clock_offset_ns + int(CLOCK_DRIFT * (now_ns - self._last_arrival_ns))
            self._clock_offset_ns = min(delay_ns, crept)
        self._last_capture_ns, self._last_arrival_ns = capture_ns, now_ns
        return max(0, capture_ns + self._clock_offset_ns - int(self._config.latency_s * 1e9))

    def _require_jump(self, delay_ns: int) -> None:
        """Rejects a late pose; unless all have been late alike for a while, then the mapping starts anew."""
        late = self._late
        late.append(delay_ns)
        if len(late) < LATE_POSES_MAX or max(late) - min(late) > LATE_SPREAD_NS:
            raise _RejectedError("late")
        self._clock_offset_ns = min(late)


class _RejectedError(Exception):
    """A datagram that holds no pose to relay."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


Content = tuple[int, Vector3, Quaternion]
"""Capture's clock, us; position; attitude."""


def _odometry(f: tuple[Any, ...]) -> Content:
    frame, child_frame = f[56], f[57]  # after time, x y z, q, six rates and two covariances of 21
    if frame not in LOCAL_FRAMES or child_frame != mavlink.MAV_FRAME_BODY_FRD:
        raise _RejectedError("frame")
    return f[0], (f[1], f[2], f[3]), (f[4], f[5], f[6], f[7])


def _att_pos_mocap(f: tuple[Any, ...]) -> Content:
    return f[0], (f[5], f[6], f[7]), (f[1], f[2], f[3], f[4])


def _vicon(f: tuple[Any, ...]) -> Content:
    return f[0], (f[1], f[2], f[3]), quaternion_of_euler(f[4], f[5], f[6])


_CONTENTS: Final[dict[int, Callable[[tuple[Any, ...]], Content]]] = {
    mavlink.MAVLINK_MSG_ID_ODOMETRY: _odometry,
    mavlink.MAVLINK_MSG_ID_ATT_POS_MOCAP: _att_pos_mocap,
    mavlink.MAVLINK_MSG_ID_VICON_POSITION_ESTIMATE: _vicon,
}
"""What is accepted, and where its fields lie (wire order)."""


def quaternion_of_euler(roll: float, pitch: float, yaw: float) -> Quaternion:
    """Quaternion wxyz, body to world, of yaw-pitch-roll angles in rad; NaN where an angle is not finite."""
    if not isfinite(roll + pitch + yaw):
        return nan, nan, nan, nan
    cr, sr = cos(roll / 2), sin(roll / 2)
    cp, sp = cos(pitch / 2), sin(pitch / 2)
    cy, sy = cos(yaw / 2), sin(yaw / 2)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )
