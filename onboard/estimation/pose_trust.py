"""Compares the poses of the motion capture with what the vehicle measures itself, in flight.

A single pose is implausible if the vehicle cannot have got there since the last pose that was used: what its own
estimate may have lost since then is bounded, tightly while optical flow is alive. The same holds for its attitude
and the gyroscope.

A slow drift of the poses takes the estimate with it. It shows in the residuals of the aids that the estimate then
leaves unused. The residual of the flow is summed up over `pose_drift_average_s`: the distance by which the poses
have moved the estimate away from the flow. The height needs two witnesses, range and pressure: an object below the
vehicle is seen by the range alone.
"""

import math
from typing import Final

from onboard.estimation.config import EstimatorConfig
from protocol.conventions import NEVER_NS
from protocol.geometry import Rotation, Vector3

SLOW_S: Final = 0.2
FAST_S: Final = 0.1
"""Of averages. A steady climb is the difference of the two over the difference of their times."""
RANGE_STEP_MAX_M: Final = 0.3
"""An outlier of the range counts as no more."""
PRESSURE_SHARE: Final = 0.6
"""Share of `pose_drift_m` by which the pressure must confirm the range."""
TURN_RATE_RAD_S: Final = 0.02
"""What the attitude may lose without poses."""
STEP_MAX_S: Final = 0.1
"""A residual counts for no longer than this."""


class PoseTrust:
    """What the vehicle's own sensors say of the poses."""

    def __init__(self, config: EstimatorConfig) -> None:
        self._config = config
        self._fresh_ns = int(config.aid_fresh_s * 1e9)
        self._flow_ns = self._range_ns = self._pressure_ns = NEVER_NS
        self._north_m = self._east_m = 0.0
        self._north_m_s = self._east_m_s = 0.0
        self._range_m = self._pressure_m = self._slow_m = self._fast_m = 0.0
        self.drifting = False
        """The poses were found to drift, and none was used since then."""
        self.blind = False
        """Samples of the IMU were missing since the last pose that was used: no pose is implausible."""

    def implausible(self, innovation: Vector3, turn: Vector3, rate: Vector3, age_s: float, now_ns: int) -> bool:
        """Whether a pose is where the vehicle cannot be.

        Parameters
        ----------
        innovation: m, position of the pose against the estimate.
        turn: rad, its attitude against the estimate; zero if the attitude is not known better.
        rate: rad/s, of the vehicle: an error of the capture time turns the attitude.
        age_s: since the last pose that was used.
        """
        if self.blind:
            return False
        config = self._config
        far_m = self._lost_m(age_s, now_ns) + (0.0 if self.drifting else config.pose_jump_m)
        turned = config.pose_turn_max_rad + TURN_RATE_RAD_S * age_s + config.pose_time_error_max_s * math.hypot(*rate)
        return math.hypot(*innovation) > far_m or math.hypot(*turn) > turned

    def _lost_m(self, age_s: float, now_ns: int) -> float:
        """What the position may have lost in `age_s` without poses."""
        seen, config = now_ns - self._flow_ns < self._fresh_ns, self._config
        return age_s * (config.pose_jump_rate_m_s if seen else config.pose_blind_rate_m_s)

    def note_jump(self, step: Vector3, age_s: float, now_ns: int) -> None:
        """Add a jump to a pose: what is more than the position may have lost moves it away from the flow."""
        across_m = math.hypot(step[0], step[1])
        more_m = across_m - self._lost_m(age_s, now_ns)
        if more_m > 0.0:
            self._north_m -= step[0] * more_m / across_m
            self._east_m -= step[1] * more_m / across_m

    def note_flow(self, innovation: tuple[float, float], rotation: Rotation, now_ns: int) -> None:
        """Add a residual of the flow, m/s along body x and y."""
        dt = min(max((now_ns - self._flow_ns) * 1e-9, 0.0), STEP_MAX_S)
        self._flow_ns = now_ns
        x, y = innovation
        north, east = rotation[0] * x + rotation[1] * y, rotation[3] * x + rotation[4] * y
        keep = math.exp(-dt / self._config.pose_drift_average_s)
        self._north_m, self._east_m = keep * self._north_m + dt * north, keep * self._east_m + dt * east
        share = 1.0 - math.exp(-dt / SLOW_S)
        self._north_m_s += share * (north - self._north_m_s)
        self._east_m_s += share * (east - self._east_m_s)

    def note_range(self, down_m: float, innovation_m: float, now_ns: int) -> None:
        """Add a position along d that the range gives, and its residual."""
        if now_ns - self._range_ns > self._fresh_ns:
            self._slow_m = self._fast_m = down_m
        dt = min(max((now_ns - self._range_ns) * 1e-9, 0.0), STEP_MAX_S)
        self._range_ns = now_ns
        fast, slow = 1.0 - math.exp(-dt / FAST_S), 1.0 - math.exp(-dt / SLOW_S)
        self._range_m += fast * _step(self._range_m, innovation_m)
        down_m = self._slow_m + _step(self._slow_m, down_m)
        self._slow_m += slow * (down_m - self._slow_m)
        self._fast_m += fast * (down_m - self._fast_m)

    def note_pressure(self, innovation_m: float, now_ns: int) -> None:
        """Add a residual of the pressure, against the height of the last seconds."""
        dt = min(max((now_ns - self._pressure_ns) * 1e-9, 0.0), STEP_MAX_S)
        self._pressure_ns = now_ns
        self._pressure_m += (1.0 - math.exp(-dt / SLOW_S)) * (innovation_m - self._pressure_m)

    def forget(self) -> None:
        """Forget all residuals: no poses are used, or the vehicle stands on the ground."""
        self._north_m = self._east_m = self._north_m_s = self._east_m_s = self._range_m = self._pressure_m = 0.0

    def drift(self, position: Vector3, velocity: Vector3, now_ns: int) -> tuple[Vector3, Vector3] | None:
        """By how much the poses have moved `position` (m) and `velocity` (m/s) away; None if they have not.

        The residuals are forgotten with it. The third number of each is 0 without a range.
        """
        limit_m = self._config.pose_drift_m
        across = math.hypot(self._north_m, self._east_m) > limit_m
        known = now_ns - self._range_ns < self._fresh_ns
        both = known and now_ns - self._pressure_ns < self._fresh_ns
        confirmed = math.copysign(1.0, self._range_m) * self._pressure_m > PRESSURE_SHARE * limit_m
        along = both and confirmed and abs(self._range_m) > limit_m
        if not (across or along):
            return None
        climb_m_s = (self._fast_m - self._slow_m) / (SLOW_S - FAST_S)
        down_m = self._fast_m + FAST_S * climb_m_s  # the average is of the time FAST_S ago
        down_m, down_m_s = (down_m - position[2], climb_m_s - velocity[2]) if known else (0.0, 0.0)
        found = (self._north_m, self._east_m, down_m), (self._north_m_s, self._east_m_s, down_m_s)
        self.forget()
        self.drifting = True
        return found


def _step(average_m: float, new_m: float) -> float:
    """The step from an average to a new value, within RANGE_STEP_MAX_M."""
    return min(max(new_m - average_m, -RANGE_STEP_MAX_M), RANGE_STEP_MAX_M)
