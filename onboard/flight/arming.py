"""Arming checks that the supervisor does not make itself. They are not evaluated in flight.

They cover the vehicle's stream, its sensors at rest, optical flow, the pose against the IMU, and the preflight
certificate (onboard/preflight/certificate.py).
"""

import math

from onboard.config import OnboardConfig
from onboard.estimation.pose_health import PoseHealth
from onboard.links.vehicle import VehicleLink
from onboard.preflight.certificate import Clearance
from protocol.conventions import NEVER_NS


class ArmingChecks:
    """Collects the checks of a vehicle that stands on the floor."""

    def __init__(self, config: OnboardConfig, clearance: Clearance) -> None:
        self._clearance = clearance
        self._needs_pose = config.supervisor.arm_needs_pose
        self._pose_stale_ns = round(config.supervisor.pose_stale_s * 1e9)
        self._pose_wait_ns = math.inf if config.pose_wait_s is None else round(config.pose_wait_s * 1e9)
        self._flow_silent_ns = round(config.vehicle_link.health.flow_silent_s * 1e9)
        self._pose_health = PoseHealth(config.pose_health)
        self._last_pose_ns = NEVER_NS
        self._started_ns: int | None = None

    def receive_pose(self, down_m: float, quaternion: list[float], link: VehicleLink, now_ns: int) -> None:
        """Note a pose of the motion capture, to be compared with the mean specific force of the vehicle link.

        Parameters
        ----------
        down_m: of the position, world NED.
        quaternion: [4], wxyz, body FRD to world.
        """
        self._last_pose_ns = now_ns
        w, x, y, z = quaternion
        self._pose_health.add(down_m, (w, x, y, z), now_ns, link.health.force)

    def refusal(self, now_ns: int, posed: bool, link: VehicleLink) -> str:
        """The first reason to refuse arming; "" if there is none.

        posed: whether a pose has ever been used. Arming waits for a first pose, so that the flight does not begin
        with a jump of the position.
        """
        if self._started_ns is None:
            self._started_ns = now_ns
        if link.conflict:
            return "two vehicles use one system id"
        if link.health.fault or self._clearance.refusal:
            return link.health.fault or self._clearance.refusal
        if self._flow_silent_ns and now_ns - link.last_flow_ns > self._flow_silent_ns:
            return "no optical flow"
        if not posed and now_ns - self._started_ns < self._pose_wait_ns:
            return "waiting for the first pose"
        if not self._needs_pose or now_ns - self._last_pose_ns > self._pose_stale_ns:
            return ""  # old poses are not judged
        return self._pose_health.fault
