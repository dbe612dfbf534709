"""Pose relay: MAVLink from the motion capture in, Pose out.

Each datagram holds one frame (protocol/mavlink/motion_capture.py). The relay maps the capture's clock to ours by the
least delay of the last seconds (protocol/clock_map.py), so a late datagram keeps the time of its pose. A capture that
has lost the vehicle may repeat the last pose with new times; the relay then sends nothing, and onboard sees the pose
become old.
"""

from collections import Counter, deque
from math import hypot, isfinite
from typing import Final

import numpy as np

from offboard.config import PoseRelayConfig
from protocol.clock_map import ClockMap
from protocol.geometry import Quaternion, Vector3
from protocol.mavlink.frames import FrameReader
from protocol.mavlink.motion_capture import DECODERS, FRAME_BYTES_MAX, CapturedPose
from protocol.mavlink.signing import SIGNATURE_FAULTS, SigningClock
from protocol.messages import Pose

QUATERNION_TOLERANCE: Final = 0.01
CLOCK_JUMP_NS: Final = 500_000_000
"""A larger difference between the actual and the expected arrival is a recording, or the capture's clock jumped."""
CLOCK_SILENT_NS: Final = 300_000_000
"""Such a jump is followed after this time without a pose on the present clock: the one with recordings goes on."""
LATE_NS: Final = 50_000_000
"""A pose that is later than expected by more than this is not relayed."""
LATE_POSES_MAX: Final = 50
LATE_SPREAD_NS: Final = 20_000_000
"""LATE_POSES_MAX poses in a row that are late by the same time within this spread mean that a clock jumped."""
FROZEN_POSES: Final = 10
"""This many identical poses in a row mean that the capture is frozen."""
AHEAD_POSES: Final = 3
"""This many poses in a row with stamps ahead of their cause mean that the capture's clock jumped."""
REPORT_PERIOD_NS: Final = 10**9
"""Least time between two events with the same reason."""
REASONS: Final = {
    "length": "wrong length of a datagram",
    "message": "message without a pose",
    "frame_bytes": "corrupted frame, or several frames in one datagram",
    **dict.fromkeys(SIGNATURE_FAULTS, "the signature is missing, wrong or repeated"),
    "frame": "frame is not local north-east-down with body forward-right-down",
    "not_finite": "nan or infinity",
    "too_far": "position beyond position_limit_m",
    "quaternion": "length of the quaternion is not 1",
    "old": "time does not increase",
    "late": "late datagram",
    "other_clock": "time is far from that of the poses before",
    "ahead": "time is ahead of the arrival",
    "frozen": "repeats one pose (frozen)",
}
"""Reasons to refuse a datagram, and their text in the event."""


class PoseRelay:
    """Decodes the motion capture's datagrams. Refused datagrams are counted by reason in `rejected`."""

    def __init__(
        self, config: PoseRelayConfig, key: bytes | None = None, signing_clock: SigningClock | None = None
    ) -> None:
        """With a `key` unsigned frames are refused. Raises ValueError if the key is not 32 bytes long."""
        self._position_limit_m = config.position_limit_m
        self._latency_ns = int(config.latency_s * 1e9)
        self._reader = FrameReader(DECODERS, key, signing_clock, config.signing_tolerance_s)
        self._clock = ClockMap()
        self._last_capture_ns: int | None = None
        self._used_ns = 0
        self._ahead = 0
        self._late: deque[int] = deque(maxlen=LATE_POSES_MAX)
        self._last_pose: tuple[Vector3, Quaternion] | None = None
        self._same = 0
        self._reported_ns: dict[str, int] = {}
        self._events: list[tuple[int, str]] = []
        self.relayed = 0
        self.clock_steps = 0
        """How often the capture's clock stepped, or was restarted."""
        self.rejected: Counter[str] = Counter()

    def receive(self, datagram: bytes, now_ns: int) -> Pose | None:
        """The pose in a datagram; None if it is refused."""
        try:
            pose = self._pose(datagram, now_ns)
        except _RejectedError as rejection:
            self.rejected[rejection.reason] += 1
            self._report(rejection.reason, now_ns)
            return None
        self.relayed += 1
        return pose

    def screen(self, datagram: bytes) -> int:
        """The kind of a datagram: its message id; -1 if it is not one frame of the motion capture."""
        found = self._reader.screen(datagram) if len(datagram) <= FRAME_BYTES_MAX else None
        return -1 if found is None else found[0]

    def take_events(self) -> list[tuple[int, str]]:
        """Return and clear the events since the last call: (time_ns, text)."""
        events, self._events = self._events, []
        return events

    def _report(self, reason: str, now_ns: int) -> None:
        if now_ns - self._reported_ns.get(reason, -REPORT_PERIOD_NS) >= REPORT_PERIOD_NS:
            self._reported_ns[reason] = now_ns
            self._events.append((now_ns, f"motion capture: {REASONS[reason]}, pose ignored"))

    def _pose(self, datagram: bytes, now_ns: int) -> Pose:
        captured = self._decode(datagram, now_ns)
        norm = self._checked_norm(captured)
        time_ns = self._map_time(captured.time_ns, now_ns)
        self._refuse_frozen(captured)
        w, x, y, z = captured.quaternion
        numbers = np.array((*captured.position_ned_m, w / norm, x / norm, y / norm, z / norm), np.float32)
        return Pose(time_ns, numbers[:3], numbers[3:])

    def _decode(self, datagram: bytes, now_ns: int) -> CapturedPose:
        """The one pose of a datagram."""
        if not 0 < len(datagram) <= FRAME_BYTES_MAX:
            raise _RejectedError("length")
        frames = self._reader.read(datagram, now_ns)
        if len(frames) != 1:
            found, unusable = self._reader.rejected, not frames
            reason = next((one for one in (*REASONS, "message_not_allowed") if unusable and found.pop(one, 0)), "")
            found.clear()
            raise _RejectedError({"": "frame_bytes", "message_not_allowed": "message"}.get(reason, reason))
        pose = DECODERS[frames[0].message_id](frames[0].fields)
        if pose is None:
            raise _RejectedError("frame")
        return pose

    def _checked_norm(self, pose: CapturedPose) -> float:
        """The length of the quaternion, after the checks of position and quaternion."""
        n, e, d = pose.position_ned_m
        norm = hypot(*pose.quaternion)
        if not isfinite(n + e + d + norm):
            raise _RejectedError("not_finite")
        limit = self._position_limit_m
        if not (-limit <= n <= limit and -limit <= e <= limit and -limit <= d <= limit):
            raise _RejectedError("too_far")
        if abs(norm - 1.0) > QUATERNION_TOLERANCE:
            raise _RejectedError("quaternion")
        return norm

    def _refuse_frozen(self, captured: CapturedPose) -> None:
        """Refuse a pose that came unchanged too often."""
        pose = captured.position_ned_m, captured.quaternion
        self._same = self._same + 1 if pose == self._last_pose else 0
        self._last_pose = pose
        if self._same >= FROZEN_POSES:
            raise _RejectedError("frozen")

    def _map_time(self, capture_ns: int, now_ns: int) -> int:
        """The time of the pose in our clock; refuses a pose older than the last one, a late one and one ahead."""
        clock, delay_ns = self._clock, now_ns - capture_ns
        if clock.known and abs(delay_ns - clock.offset_ns) > CLOCK_JUMP_NS:
            if now_ns - self._used_ns < CLOCK_SILENT_NS:
                raise _RejectedError("other_clock")
            self._follow_step(delay_ns, now_ns)
            self._last_capture_ns = None
        if self._last_capture_ns is not None and capture_ns <= self._last_capture_ns:
            raise _RejectedError("old")
        if clock.is_ahead(delay_ns):
            self._ahead += 1
            if self._ahead < AHEAD_POSES:
                raise _RejectedError("ahead")
            self._follow_step(delay_ns, now_ns)
        elif clock.known and delay_ns - clock.offset_ns > LATE_NS:
            self._require_clock_jump(delay_ns)
            self._follow_step(delay_ns, now_ns)
        self._late.clear()
        self._ahead = 0
        clock.add(delay_ns, now_ns)
        self._last_capture_ns, self._used_ns = capture_ns, now_ns
        return max(0, clock.to_ours(capture_ns, now_ns) - self._latency_ns)

    def _follow_step(self, delay_ns: int, now_ns: int) -> None:
        """Map the capture's clock anew, and report by how much it stepped."""
        step_s = (self._clock.offset_ns - delay_ns) * 1e-9
        self._clock.reset()
        self.clock_steps += 1
        self._events.append((now_ns, f"motion capture: its clock stepped by {step_s:+.3f} s; mapped again"))

    def _require_clock_jump(self, delay_ns: int) -> None:
        """Refuse a late pose, unless many poses in a row are equally late: then the mapping starts again."""
        late = self._late
        late.append(delay_ns)
        if len(late) < LATE_POSES_MAX or max(late) - min(late) > LATE_SPREAD_NS:
            raise _RejectedError("late")


class _RejectedError(Exception):
    """A datagram without a pose to relay."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason
