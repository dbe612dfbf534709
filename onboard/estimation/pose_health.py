"""Checks before arming whether the relayed pose is good enough: its rate, its upright against the IMU's, its floor.

The newest poses are stored; every few of them are judged, while the vehicle stands still on the floor. Heading cannot
be judged there: `dmrac preflight` checks it with the help of a person.
"""

from collections import deque
from typing import Final

import numpy as np
from pydantic import Field

from configs.loader import ConfigRecord
from protocol.conventions import Array
from protocol.geometry import Quaternion, rotation_of

POSES: Final = 32
EVERY: Final = 8
"""Poses between two judgements."""
NOT_COMPARED: Final = "the pose has not been compared with the IMU yet"


class PoseHealthConfig(ConfigRecord):
    """Limits for the pose before arming, where arming needs a pose."""

    rate_min_hz: float = Field(default=20.0, gt=0, description="Hz, poses that arrive")
    upright_tolerance_rad: float = Field(default=0.2, gt=0, description="rad; pose's upright against the IMU's")
    floor_tolerance_m: float = Field(default=0.3, gt=0, description="m; pose's height of a vehicle on the floor")


class PoseHealth:
    """Judges the newest poses when `fault` is read; it is not read in flight."""

    def __init__(self, config: PoseHealthConfig) -> None:
        self._config = config
        self._arrivals_ns: deque[int] = deque(maxlen=POSES)
        self._poses: deque[tuple[float, Quaternion]] = deque(maxlen=POSES)
        self._force: Array = np.zeros(3)
        self._count = 0
        self._next_judgement = EVERY
        self._fault = ""

    @property
    def fault(self) -> str:
        """Why the poses are not good enough; "" if they are."""
        if self._count >= self._next_judgement:
            self._next_judgement = (self._count // EVERY + 1) * EVERY
            self._fault = self._judge()
        return self._fault

    def add(self, down_m: float, quaternion: Quaternion, now_ns: int, force: Array) -> None:
        """Add a pose.

        Parameters
        ----------
        down_m: of the position, world NED.
        quaternion: wxyz, body to world.
        now_ns: arrival.
        force: [3] m/s^2, the IMU's mean specific force.
        """
        self._arrivals_ns.append(now_ns)
        self._poses.append((down_m, quaternion))
        self._force = force
        self._count += 1

    def _judge(self) -> str:
        config, arrivals_ns, force = self._config, self._arrivals_ns, self._force
        seconds = (arrivals_ns[-1] - arrivals_ns[0]) * 1e-9
        rate_hz = (len(arrivals_ns) - 1) / seconds if seconds > 0.0 else 0.0
        if rate_hz < config.rate_min_hz:
            return f"pose at {rate_hz:.0f} Hz"
        rows = [(down_m, *rotation_of(quaternion)[6:]) for down_m, quaternion in self._poses]
        down_m, *down_axis = np.mean(rows, axis=0)  # the world's down, in the body
        length = float(np.linalg.norm(force) * np.linalg.norm(down_axis))
        if length <= 0.0:
            return NOT_COMPARED
        angle = float(np.arccos(np.clip(-(force @ np.array(down_axis)) / length, -1.0, 1.0)))
        if angle > config.upright_tolerance_rad:
            return f"pose and IMU are {np.degrees(angle):.0f} deg apart in tilt: wrong frame or order of the pose"
        if abs(down_m) > config.floor_tolerance_m:
            return f"pose is {-down_m:+.2f} m above the floor at rest: its zero must be the floor, d down, in metres"
        return ""
