"""Fuses the poses of the motion capture: position and attitude as of their capture time.

A pose outside the gate is refused, until several refused poses in a row agree with each other: then the state jumps
to them. The very first poses always jump. An error of the capture time is a position error in proportion to speed,
and an attitude error in proportion to rate; the variances contain both. While the vehicle rotates, an attitude that
a wrong capture time explains is left out, also in a jump: it would disturb a vehicle that knows its tilt better.
Under strong vibration, poses that disagree mean that the velocity is wrong.

In flight a pose that is implausible (pose_trust.py) is refused, however many agree with it. If the poses drift away
from flow, or from range and pressure, the estimate goes back by the drift, and flies on without poses until they
are plausible.
"""

import math
from typing import Final

from onboard.estimation.config import EstimatorConfig
from onboard.estimation.corrections import Corrections
from onboard.estimation.error_state_filter import ATTITUDE, POSITION, VELOCITY, ErrorStateFilter
from onboard.estimation.pose_trust import PoseTrust
from onboard.estimation.state import VehicleState
from onboard.estimation.state_history import PastState
from onboard.estimation.stuck_gyro import StuckGyro
from protocol.conventions import NEVER_NS
from protocol.geometry import (
    ZERO,
    Vector3,
    add,
    matrix_times,
    rotation_between,
    squared_length,
    subtract,
    turned_about_vertical,
    vector,
)
from protocol.messages import Pose

FUTURE_NS: Final = 20_000_000
"""A pose this far ahead of now has a wrong time stamp."""
WRONG_FOR_S: Final = 0.02
"""How long a velocity has been wrong when poses show it: the time between two poses."""
LARGE_TURN_RAD: Final = 0.2
DRIFT_VELOCITY_SIGMA: Final = 0.2
DRIFT_HEIGHT_SIGMA: Final = 0.1
DRIFT_CLIMB_SIGMA: Final = 0.3
"""m and m/s, of height and climb then, which come from the range."""


class PoseFusion:
    """Decides which poses are used, and corrects the filter."""

    def __init__(
        self,
        config: EstimatorConfig,
        error_state: ErrorStateFilter,
        state: VehicleState,
        corrections: Corrections,
        gyro: StuckGyro,
    ) -> None:
        self._config = config
        self._filter = error_state
        self._state = state
        self._corrections = corrections
        self._gyro = gyro
        self._counts = corrections.counts
        self._delay_max_ns = int(config.pose_delay_max_s * 1e9)
        self._last_capture_ns = NEVER_NS
        self._refused = 0
        self._refused_position: Vector3 = ZERO
        self._had_pose = False
        self.trust = PoseTrust(config)

    def receive(self, pose: Pose, capture_ns: int, now_ns: int, time_sigma_s: float) -> None:
        """A pose that was true at `capture_ns` (onboard clock, standard deviation `time_sigma_s`)."""
        if capture_ns <= self._last_capture_ns:
            self._counts["pose_out_of_order"] += 1
            return
        timely = now_ns - capture_ns <= self._delay_max_ns and capture_ns - now_ns <= FUTURE_NS
        past = self._filter.at(capture_ns) if timely else None
        if past is None:
            self._counts["pose_wrong_time"] += 1
            return
        self._last_capture_ns = capture_ns
        innovation = subtract(vector(pose.position_ned_m.tolist()), past.position)
        if self._is_implausible(pose, past, innovation, now_ns):
            self._counts["pose_implausible"] += 1
            self._counts["pose_refused"] += 1
            return
        if self._had_pose and self._fuse(pose, innovation, capture_ns, now_ns, time_sigma_s):
            self._refused = 0
            self._counts["pose_used"] += 1
            self._accept(now_ns)
            return
        self._refuse(pose, capture_ns, now_ns)

    def _is_implausible(self, pose: Pose, past: PastState, innovation: Vector3, now_ns: int) -> bool:
        """Whether a pose in flight is where the vehicle cannot be. The first one may be anywhere."""
        if not self._had_pose or not self._corrections.in_flight:
            return False
        turn = ZERO if self._gyro.axes else rotation_between(tuple(pose.quaternion.tolist()), past.rotation)
        age_s = (now_ns - self._state.last_pose_ns) * 1e-9
        return self.trust.implausible(innovation, turn, past.rate_world, age_s, now_ns)

    def check_drift(self, now_ns: int) -> None:
        """After a residual of flow or range: undo what drifting poses have done to the estimate."""
        config, f, trust = self._config, self._filter, self.trust
        if not (self._had_pose and self._corrections.in_flight) or self._gyro.axes or trust.drifting or trust.blind:
            trust.forget()
            return
        fresh = now_ns - self._state.last_pose_ns < int(config.aid_fresh_s * 1e9)
        found = trust.drift(f.position, f.velocity, now_ns) if fresh else None
        if found is None:
            return
        before = f.position
        f.shift(found[0], found[1], ZERO)
        f.inflate(VELOCITY, DRIFT_VELOCITY_SIGMA, 2)
        if found[0][2]:
            f.inflate(POSITION + 2, DRIFT_HEIGHT_SIGMA, 1)
            f.inflate(VELOCITY + 2, DRIFT_CLIMB_SIGMA, 1)
        self._refused = 0
        self._counts["pose_drift"] += 1
        text = f"the poses drift, by {math.hypot(*found[0]):.2f} m against flow or range: refused"
        self._corrections.report(now_ns, text)
        self._corrections.announce_jump(before, "pose", now_ns, always=True)

    def _fuse(self, pose: Pose, innovation: Vector3, capture_ns: int, now_ns: int, time_sigma_s: float) -> bool:
        """Position, then attitude. True if the pose was used.

        A pose that is off by more than its variance allows, but not by much in metres and radians, gets less weight,
        so that it just passes the gate (Huber): a delay that differs from the configured one must not look like wrong
        poses.
        """
        config, f = self._config, self._filter
        before = f.position
        delay_s = (self._state.last_imu_ns - capture_ns) * 1e-9
        sigma_s = max(config.pose_time_sigma_s, time_sigma_s)
        variance = config.pose_position_sigma_m**2 + sigma_s**2 * squared_length(f.velocity)
        if self._state.vibration > config.vibration_white_max_m_s2:
            self._widen_velocity(innovation, delay_s)
        variance = _softened(variance, squared_length(innovation), config.pose_near_m, config.pose_gate)
        score = f.correct_position(innovation, delay_s, variance, config.pose_gate)
        self._corrections.note_score("pose_position", score, config.pose_gate, 3)
        if score > config.pose_gate:
            return False
        self._corrections.announce_jump(before, "pose", now_ns)
        past = f.at(capture_ns)
        if past is not None and self._gyro.axes:
            self._fuse_attitude_of_lost_axis(pose, past, capture_ns, time_sigma_s)
        elif past is not None:
            turn = rotation_between(tuple(pose.quaternion.tolist()), past.rotation)
            variance = self._attitude_variance(past, time_sigma_s)
            variance = _softened(variance, squared_length(turn), config.pose_near_rad, config.pose_gate)
            score = f.correct_attitude(turn, variance, config.pose_gate)
            self._corrections.note_score("pose_attitude", score, config.pose_gate, 3)
            if score > config.pose_gate:
                self._counts["pose_attitude_refused"] += 1
                return self._explained_by_time(turn, past.rate_world)
        return True

    def _fuse_attitude_of_lost_axis(self, pose: Pose, past: PastState, capture_ns: int, time_sigma_s: float) -> None:
        """Attitude while an axis of the gyroscope is stuck: it is the only measurement of that axis's rate.

        So it is never left out. A correction of the rate turns the stored attitudes, and a pose that is far off gets
        less weight.
        """
        config, f = self._config, self._filter
        # R_past as if the present bias had been known since then: exp(-turn) R_past
        more = matrix_times(f.rotation, self._gyro.turn_since(capture_ns, f.gyro_bias))
        turn = add(rotation_between(tuple(pose.quaternion.tolist()), past.rotation), more)
        variance = self._attitude_variance(past, time_sigma_s)
        delay_s = (self._state.last_imu_ns - capture_ns) * 1e-9
        if f.correct_past_attitude(turn, delay_s, variance, config.pose_gate) > config.pose_gate:
            softened = _softened(variance, squared_length(turn), math.inf, config.pose_gate)
            f.correct_past_attitude(turn, delay_s, softened, math.inf)

    def _attitude_variance(self, past: PastState, time_sigma_s: float) -> float:
        """Of the attitude of a pose, rad^2 per axis: its own noise, and the turn within the error of its time."""
        config = self._config
        sigma_s = max(config.pose_turn_time_sigma_s, time_sigma_s)
        return config.pose_attitude_sigma_rad**2 + sigma_s**2 * squared_length(past.rate_world)

    def _explained_by_time(self, turn: Vector3, rate: Vector3) -> bool:
        """Whether a wrong capture time alone may explain the difference `turn` of a pose's attitude from ours."""
        config = self._config
        return math.hypot(*turn) < config.pose_near_rad + config.pose_time_error_max_s * math.hypot(*rate)

    def _widen_velocity(self, innovation: Vector3, delay_s: float) -> None:
        """Increase the uncertainty of the velocity if vibration is strong and a pose shows that the velocity is wrong.

        The vibration of an unbalanced rotor, aliased to a low frequency by the sampling, is not white: it adds up in
        the velocity far beyond the variance. An innovation larger than the variances allow then means a velocity that
        has been wrong since the poses before. It is no reason to give the pose less weight.
        """
        f, config = self._filter, self._config
        n, e, d = f.P.diagonal()[:3].tolist()
        off = squared_length(innovation)
        if off > 2.0 * (n + e + d + 3.0 * config.pose_position_sigma_m**2):
            f.inflate_motion(math.sqrt(off) / WRONG_FOR_S, WRONG_FOR_S + delay_s)

    def _accept(self, now_ns: int) -> None:
        state = self._state
        self._had_pose = True
        self.trust.drifting = self.trust.blind = False
        state.last_pose_ns = state.last_velocity_aid_ns = state.last_height_ns = now_ns

    def _refuse(self, pose: Pose, capture_ns: int, now_ns: int) -> None:
        """Count a refused pose; jump to it if enough of them in a row agree."""
        position = vector(pose.position_ned_m.tolist())
        agrees = math.dist(position, self._refused_position) < self._config.pose_agree_m
        self._refused_position = position
        self._refused = self._refused + 1 if agrees and self._refused else 1
        self._counts["pose_refused"] += 1
        if self._refused >= self._config.pose_reset_count:
            self._refused = 0
            self._jump_to(pose, capture_ns, now_ns)

    def _jump_to(self, pose: Pose, capture_ns: int, now_ns: int) -> None:
        """Set position and attitude to a pose. The velocity stays; its uncertainty grows, except at the first pose."""
        config, f = self._config, self._filter
        past = f.at(capture_ns)
        if past is None:
            return
        turn = rotation_between(tuple(pose.quaternion.tolist()), past.rotation)
        if self._had_pose and self._explained_by_time(turn, past.rate_world):
            turn = ZERO
        before, yaw = f.position, self._state.euler[2]
        step = subtract(vector(pose.position_ned_m.tolist()), past.position)
        self.trust.note_jump(step, (now_ns - self._state.last_pose_ns) * 1e-9, now_ns)
        f.shift(step, ZERO, turn)
        # The velocity turns with the frame: what flow measured was in the body frame.
        f.velocity = turned_about_vertical(turn, f.velocity)
        f.restart_error(POSITION, 2.0 * config.pose_position_sigma_m)
        if any(turn):
            f.restart_error(ATTITUDE, 2.0 * config.pose_attitude_sigma_rad)
        if self._had_pose:
            # the position is known as of the capture time: since then the velocity has moved it
            f.restart_error(VELOCITY, 0.0)
            f.inflate_motion(1.0, (self._state.last_imu_ns - capture_ns) * 1e-9)
        if math.hypot(*turn) > LARGE_TURN_RAD:
            f.forget_history()
        self._counts["pose_jump"] += 1
        self._accept(now_ns)
        self._state.publish_attitude(f)
        self._corrections.announce_jump(before, "pose", now_ns, float(self._state.euler[2] - yaw), always=True)


def _softened(variance: float, off: float, near: float, gate: float) -> float:
    """The variance at which an innovation of squared length `off` passes the gate, if it is not larger than `near`."""
    return max(variance, off / gate) if off <= near * near else variance
