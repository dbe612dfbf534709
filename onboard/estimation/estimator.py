"""Where are we, how fast, which way up: IMU, relayed pose, optical flow, ultrasonic range and pressure in one filter.

The filter itself is in error_state_filter.py; this file decides what it is told.

  start       at rest, roll and pitch from the accelerometer, gyro bias from the gyroscope, yaw and position 0; with
              no pose ever, that stays the origin
  on ground   velocity is zero, the gyroscope reads its bias, height is zero unless a pose says otherwise
  pose        position and attitude as of its capture time. What the gate refuses is dropped, until several refused
              poses in a row agree with each other: then the state jumps to them. The very first poses always jump.
              Each is as uncertain as its capture time. While the vehicle turns, an attitude that a wrong time would
              explain is left out and turns nothing: a jump to it would upset a vehicle that knows its tilt better.
              While vibration is strong, poses that disagree say that the velocity is wrong.
  flow        body velocity = flow rate times distance to the floor along the camera's axis
  range       height over the floor at d = 0; nothing below the sensor's own floor
  pressure    height against the pressure at the start; weak
  nothing     velocity is zero give or take metres per second, which keeps the attitude level

Jumps. A correction of the position by more than `jump_threshold_m` is announced: `position_reset_count` grows and
`position_jump`, `yaw_jump` say by how much, so that a controller can shift its own references instead of being kicked.
"""

import math
from collections import Counter

import numpy as np

from onboard.estimation.config import EstimatorConfig
from onboard.estimation.error_state_filter import ATTITUDE, GYRO_BIAS, POSITION, VELOCITY, ErrorStateFilter
from onboard.estimation.imu_conditioning import StillStart, VibrationMeter
from onboard.estimation.state import VehicleState
from onboard.estimation.state_output import publish, publish_attitude, publish_sigmas
from protocol.conventions import NEVER_NS, Array
from protocol.geometry import Vector3, quaternion_of, rotation_between, squared_length, turned_about_vertical
from protocol.mavlink.sensors import FlowReading, ImuReading, RangeReading, SensorReading
from protocol.messages import Pose

__all__ = ["Estimator", "EstimatorConfig"]

_FUTURE_NS = 20_000_000
"""A pose this far ahead of now has a wrong time stamp."""
_AIR_PA_PER_M = 11.6
"""Pressure per metre at 20 degrees C near sea level."""
_ROTA = 8
"""Slow aids take turns: each is fused every eighth IMU sample, 25 Hz."""
_PRESSURE_TURN = 7
_WRONG_FOR_S = 0.02
"""For so long a velocity has been wrong when poses show it: two of them."""
_REFUSED_MIN = 8
"""Fewer refusals in a row are outliers, however far apart."""


class Estimator:
    """Holds the state of the vehicle. Readings must come in the order of their arrival."""

    def __init__(self, config: EstimatorConfig) -> None:
        self._config = config
        self._filter = ErrorStateFilter(config.covariance_every)
        self._aid_fresh_ns = int(config.aid_fresh_s * 1e9)
        self._recovery_ns = int(config.recovery_s * 1e9)
        self._delay_max_ns = int(config.pose_delay_max_s * 1e9)
        self._h_flow: Array = np.zeros(15)
        self._on_ground = True
        self._start = StillStart(config.start_samples, config.start_rate_max_rad_s)
        self._vibration = VibrationMeter()
        self._turn = 0
        self._pressure_sum, self._pressure_count = 0.0, 0
        self._pressure_zero_pa = 0.0
        self._last_height_ns = NEVER_NS
        self._last_capture_ns = NEVER_NS
        self._refused: dict[str, tuple[int, int]] = {}
        self._refused_poses = 0
        self._refused_position: Vector3 = (0.0, 0.0, 0.0)
        self._had_pose = False
        self._events: list[tuple[int, str]] = []
        self.state = VehicleState()
        """The state after the newest reading; always the same object, rewritten in place."""
        self.counts: Counter[str] = Counter()
        """Aids used and refused: "pose_used", "flow_refused" and so on."""
        self.scores: dict[str, float] = {}
        """Newest normalised innovation squared_length of each aid."""

    @property
    def covariance(self) -> Array:
        """[15, 15], of (position, velocity, world attitude error, gyro bias, accelerometer bias); a view."""
        return self._filter.P

    @property
    def healthy(self) -> bool:
        """Whether all numbers are finite. False means that nothing of the state may be used any more."""
        f = self._filter
        return math.isfinite(sum(f.position) + sum(f.velocity) + sum(f.quaternion) + sum(f.gyro_bias))

    def set_on_ground(self, on_ground: bool) -> None:
        """Whether the vehicle stands on the floor. While it does, its velocity and height are known."""
        self._on_ground = on_ground

    def take_events(self) -> list[tuple[int, str]]:
        """What happened since the last call: (time_ns, text)."""
        events, self._events = self._events, []
        return events

    def receive(self, reading: SensorReading) -> None:
        """One reading of a sensor of the vehicle."""
        if isinstance(reading, ImuReading):
            self._take_imu(reading)
        elif isinstance(reading, FlowReading):
            self._take_flow(reading)
        elif isinstance(reading, RangeReading):
            self._take_range(reading)

    # -- inertial sensors ---------------------------------------------------------------------------------------------

    def _take_imu(self, reading: ImuReading) -> None:
        state = self.state
        dt = (reading.time_ns - state.last_imu_ns) * 1e-9
        if dt <= 0.0:
            self.counts["imu_out_of_order"] += 1
            return
        first = state.last_imu_ns == NEVER_NS
        state.last_imu_ns = reading.time_ns
        if not state.initialised:
            self._find_start(reading)
            return
        if first or dt > self._config.gap_s:
            dt = self._bridge_gap(reading.time_ns, dt)
        state.vibration = self._vibration.update(reading.accelerometer, dt)
        config = self._config
        sigma = max(config.accelerometer_sigma, config.vibration_to_sigma * state.vibration)
        noise = (
            min(sigma, config.accelerometer_sigma_max),
            config.gyro_sigma,
            config.gyro_bias_walk,
            config.accelerometer_bias_walk,
        )
        self._filter.predict(reading.time_ns, dt, reading.accelerometer, reading.gyroscope, noise, config.gyro_delay_s)
        if reading.pressure_pa is not None:
            self._pressure_sum += reading.pressure_pa
            self._pressure_count += 1
        self._turn = (self._turn + 1) % _ROTA
        self._fuse_slow_aid(self._turn, reading)
        publish(state, self._filter, reading)
        state.height_valid = reading.time_ns - self._last_height_ns < 2 * self._aid_fresh_ns
        if self._turn == 0:
            publish_sigmas(state, self._filter)

    def _find_start(self, reading: ImuReading) -> None:
        """Waits for a run of still samples, then sets attitude and gyro bias from their means."""
        config = self._config
        if not self._start.add(reading):
            return
        roll, pitch = self._start.level()
        tilt = config.start_tilt_sigma_rad
        sigmas = (
            *(config.start_position_sigma_m,) * 3,
            *(config.still_velocity_sigma_m_s,) * 3,
            *(tilt, tilt, config.start_yaw_sigma_rad),
            *(config.start_gyro_bias_sigma,) * 3,
            *(config.start_accelerometer_bias_sigma,) * 3,
        )
        self._filter.start(quaternion_of(roll, pitch, 0.0), self._start.mean_rate(), sigmas)
        self.state.initialised = True
        tilts = f"roll {math.degrees(roll):.1f}, pitch {math.degrees(pitch):.1f} deg"
        self._say(reading.time_ns, f"attitude found: {tilts}")
        publish(self.state, self._filter, reading)

    def _bridge_gap(self, time_ns: int, gap_s: float) -> float:
        """Widens the uncertainty after missing IMU samples; returns the time step to integrate over."""
        self.counts["imu_gap"] += 1
        seconds = min(gap_s, 5.0)
        self._filter.inflate(VELOCITY, 3.0 * seconds)
        self._filter.inflate(POSITION, 1.5 * seconds * seconds)
        self._filter.inflate(ATTITUDE, 0.5 * seconds)
        self._say(time_ns, f"IMU gap of {gap_s * 1e3:.0f} ms")
        return min(gap_s, 0.1)

    # -- aids that take turns -----------------------------------------------------------------------------------------

    def _fuse_slow_aid(self, turn: int, reading: ImuReading) -> None:
        now_ns = reading.time_ns
        if turn == _PRESSURE_TURN:
            self._fuse_pressure(now_ns)
        elif self._on_ground:
            self._fuse_ground(turn, reading)
        elif turn < 3 and now_ns - self.state.last_velocity_aid_ns > self._recovery_ns:
            variance = self._config.unaided_velocity_sigma_m_s**2
            self._filter.correct_scalar(VELOCITY + turn, -self._filter.velocity[turn], variance, math.inf)

    def _fuse_ground(self, turn: int, reading: ImuReading) -> None:
        """Standing still: velocity 0, rate = bias, height 0."""
        config, f = self._config, self._filter
        self.state.last_velocity_aid_ns = reading.time_ns
        if turn < 3:
            f.correct_scalar(VELOCITY + turn, -f.velocity[turn], config.still_velocity_sigma_m_s**2, math.inf)
        elif turn < 6:
            axis = turn - 3
            innovation = reading.gyroscope[axis] - f.gyro_bias[axis]
            if abs(innovation) < config.start_rate_max_rad_s:  # else somebody is carrying the vehicle
                f.correct_scalar(GYRO_BIAS + axis, innovation, (3.0 * config.gyro_sigma) ** 2, math.inf)
        elif reading.time_ns - self.state.last_pose_ns > self._recovery_ns:
            f.correct_scalar(POSITION + 2, -f.position[2], config.still_height_sigma_m**2, math.inf)

    def _fuse_pressure(self, now_ns: int) -> None:
        """Height from pressure; while a better height is there, the zero follows it instead."""
        if not self._pressure_count:
            return
        pressure_pa = self._pressure_sum / self._pressure_count
        self._pressure_sum, self._pressure_count = 0.0, 0
        zero_pa = pressure_pa - _AIR_PA_PER_M * self._filter.position[2]
        if not self._pressure_zero_pa:
            self._pressure_zero_pa = zero_pa
        if self._on_ground or now_ns - self._last_height_ns < self._aid_fresh_ns:
            self._pressure_zero_pa += 0.02 * (zero_pa - self._pressure_zero_pa)
            return
        innovation = (pressure_pa - self._pressure_zero_pa) / _AIR_PA_PER_M - self._filter.position[2]
        # Means of neighbouring samples share their drift, so each is trusted as one independent value a second.
        sigma_m = 5.0 * self._config.pressure_sigma_pa / _AIR_PA_PER_M
        self._correct("pressure", POSITION + 2, innovation, sigma_m**2, self._config.pressure_gate, now_ns)

    # -- aids with their own rate -------------------------------------------------------------------------------------

    def _take_flow(self, reading: FlowReading) -> None:
        """Velocity over ground from optical flow, two scalars in the body frame at the middle of the exposure.

        v_x = d (flow_y - rotation_y) / dt, v_y = -d (flow_x - rotation_x) / dt, d the distance along body z;
        measured v_b = R^T v: error R^T dv + R^T [v]x phi.
        """
        config, f = self._config, self._filter
        if not self.state.initialised or self._on_ground or reading.quality < config.flow_quality_min:
            return
        past = f.at(reading.time_ns - int(0.5e9 * reading.integration_s))
        if past is None or past.rotation[8] < 0.7:
            return
        distance_m = -past.position[2] / past.rotation[8]
        if distance_m < config.flow_height_min_m:
            return
        scale = distance_m / reading.integration_s
        measured = (scale * (reading.flow_y - reading.rotation_y), -scale * (reading.flow_x - reading.rotation_x))
        vx, vy, vz = past.velocity
        R, h = past.rotation, self._h_flow
        used = True
        for axis in (0, 1):
            rx, ry, rz = R[axis], R[3 + axis], R[6 + axis]
            expected = rx * vx + ry * vy + rz * vz
            h[3], h[4], h[5] = rx, ry, rz
            h[6], h[7], h[8] = ry * vz - rz * vy, rz * vx - rx * vz, rx * vy - ry * vx
            sigma = config.flow_rate_sigma_rad_s * distance_m + config.flow_scale_sigma * abs(expected)
            used &= self._correct(
                "flow", h, measured[axis] - expected, sigma * sigma, config.flow_gate, reading.time_ns
            )
        if used:
            self.state.last_velocity_aid_ns = max(reading.time_ns, self.state.last_velocity_aid_ns)
        elif self._refused_long("flow", reading.time_ns) and not self._pose_fresh(reading.time_ns):
            self._widen("flow", VELOCITY, 3, 1.0, reading.time_ns)

    def _take_range(self, reading: RangeReading) -> None:
        """Height from the ultrasonic sensor over a level floor at d = 0.

        The first echo comes from straight below while the tilt is within the beam's cone, from its edge beyond it.
        """
        config, f = self._config, self._filter
        past = f.at(reading.time_ns) if self.state.initialised else None
        valid = config.range_floor_m + config.range_margin_m < reading.distance_m < config.range_max_m
        if past is None or self._on_ground or not valid or past.rotation[8] < 0.7:
            return
        beyond = math.acos(min(1.0, past.rotation[8])) - config.range_half_cone_rad
        innovation = -reading.distance_m * (math.cos(beyond) if beyond > 0.0 else 1.0) - past.position[2]
        if self._correct(
            "range", POSITION + 2, innovation, config.range_sigma_m**2, config.range_gate, reading.time_ns
        ):
            self._last_height_ns = reading.time_ns
        elif self._refused_long("range", reading.time_ns) and not self._pose_fresh(reading.time_ns):
            self._widen("range", POSITION + 2, 1, 1.0, reading.time_ns)

    def receive_pose(self, pose: Pose, capture_ns: int, now_ns: int, time_sigma_s: float = 0.0) -> None:
        """A pose from motion capture that was true at `capture_ns` (onboard clock) and arrived at `now_ns`.

        time_sigma_s: standard deviation of `capture_ns`, s, where it is more than the settings say.
        """
        if not self.state.initialised:
            return
        if capture_ns <= self._last_capture_ns:
            self.counts["pose_out_of_order"] += 1
            return
        timely = now_ns - capture_ns <= self._delay_max_ns and capture_ns - now_ns <= _FUTURE_NS
        past = self._filter.at(capture_ns) if timely else None
        if past is None:
            self.counts["pose_wrong_time"] += 1
            return
        self._last_capture_ns = capture_ns
        x, y, z = pose.position_ned_m.tolist()
        measured = (x - past.position[0], y - past.position[1], z - past.position[2])
        if self._had_pose and self._fuse_pose(pose, measured, capture_ns, now_ns, time_sigma_s):
            self._refused_poses = 0
            self.counts["pose_used"] += 1
            self._accept_pose(now_ns)
            return
        self._refuse_pose(pose, capture_ns, now_ns)

    # -- pose ---------------------------------------------------------------------------------------------------------

    def _fuse_pose(self, pose: Pose, position: Vector3, capture_ns: int, now_ns: int, time_sigma_s: float) -> bool:
        """Position, then attitude. A wrong capture time is a wrong position in proportion to speed, hence its sigma.

        A pose that is off by more than it ought to be, but not by much in metres and radians, gets as much less weight
        as makes it just probable (Huber): a delay that is not what was configured must not look like wrong poses.
        """
        config, f = self._config, self._filter
        before = f.position
        delay_s = (self.state.last_imu_ns - capture_ns) * 1e-9
        sigma_s = max(config.pose_time_sigma_s, time_sigma_s)
        variance = config.pose_position_sigma_m**2 + sigma_s**2 * squared_length(f.velocity)
        if self.state.vibration > config.vibration_white_max_m_s2:
            self._distrust_velocity(position, delay_s)
        variance = _softened(variance, squared_length(position), config.pose_near_m, config.pose_gate)
        score = f.correct_position(position, delay_s, variance, config.pose_gate)
        self.scores["pose_position"] = score
        if score > config.pose_gate:
            return False
        self._announce(before, 0.0, "pose", now_ns)
        past = f.at(capture_ns)
        if past is not None:
            turn = rotation_between(tuple(pose.quaternion.tolist()), past.rotation)
            sigma_s = max(config.pose_turn_time_sigma_s, time_sigma_s)
            variance = config.pose_attitude_sigma_rad**2 + sigma_s**2 * squared_length(past.rate_world)
            variance = _softened(variance, squared_length(turn), config.pose_near_rad, config.pose_gate)
            score = f.correct_attitude(turn, variance, config.pose_gate)
            self.scores["pose_attitude"] = score
            if score > config.pose_gate:
                self.counts["pose_attitude_refused"] += 1
                return self._explained_by_time(turn, past.rate_world)
        return True

    def _explained_by_time(self, turn: Vector3, rate: Vector3) -> bool:
        """Whether a wrong capture time may be all that turns a pose's attitude against ours."""
        config = self._config
        return math.hypot(*turn) < config.pose_near_rad + config.pose_time_error_max_s * math.hypot(*rate)

    def _distrust_velocity(self, innovation: Vector3, delay_s: float) -> None:
        """Widens the velocity where vibration is strong and a pose says that the velocity must be wrong.

        A rotor's imbalance, folded by the sampling to a low frequency, is not white: it adds up in the velocity far
        beyond the variance. An innovation larger than the variances allow is then a velocity that was wrong since the
        poses before, and no reason to give the pose less weight.
        """
        f, config = self._filter, self._config
        n, e, d = f.P.diagonal()[:3].tolist()
        off = squared_length(innovation)
        if off > 2.0 * (n + e + d + 3.0 * config.pose_position_sigma_m**2):
            f.inflate_motion(math.sqrt(off) / _WRONG_FOR_S, _WRONG_FOR_S + delay_s)

    def _accept_pose(self, now_ns: int) -> None:
        state = self.state
        self._had_pose = True
        state.last_pose_ns = now_ns
        state.last_velocity_aid_ns = now_ns
        self._last_height_ns = now_ns

    def _refuse_pose(self, pose: Pose, capture_ns: int, now_ns: int) -> None:
        """Counts a refused pose; when enough of them agree with each other, the state jumps there."""
        x, y, z = pose.position_ned_m.tolist()
        agrees = math.dist((x, y, z), self._refused_position) < self._config.pose_agree_m
        self._refused_position = (x, y, z)
        self._refused_poses = self._refused_poses + 1 if agrees and self._refused_poses else 1
        self.counts["pose_refused"] += 1
        if self._refused_poses >= self._config.pose_reset_count:
            self._refused_poses = 0
            self._jump_to(pose, capture_ns, now_ns)

    def _jump_to(self, pose: Pose, capture_ns: int, now_ns: int) -> None:
        """Sets position and attitude to a pose; velocity is kept on first contact, widened otherwise."""
        config, f = self._config, self._filter
        past = f.at(capture_ns)
        if past is None:
            return
        turn = rotation_between(tuple(pose.quaternion.tolist()), past.rotation)
        if self._had_pose and self._explained_by_time(turn, past.rate_world):
            turn = (0.0, 0.0, 0.0)
        x, y, z = pose.position_ned_m.tolist()
        before, yaw = f.position, self.state.euler[2]
        f.shift((x - past.position[0], y - past.position[1], z - past.position[2]), (0.0, 0.0, 0.0), turn)
        # A turned frame turns the velocity with it: what flow measured was in the body frame.
        f.velocity = turned_about_vertical(turn, f.velocity)
        f.restart_error(POSITION, 2.0 * config.pose_position_sigma_m)
        if any(turn):
            f.restart_error(ATTITUDE, 2.0 * config.pose_attitude_sigma_rad)
        if self._had_pose:
            f.restart_error(VELOCITY, 1.0)
        if math.hypot(*turn) > 0.2:
            f.forget_history()
        self.counts["pose_jump"] += 1
        self._accept_pose(now_ns)
        publish_attitude(self.state, self._filter)
        self._announce(before, float(self.state.euler[2] - yaw), "pose", now_ns, always=True)

    def _correct(self, aid: str, h: Array | int, innovation: float, variance: float, gate: float, now_ns: int) -> bool:
        """A gated scalar correction with its book-keeping. True when it was used."""
        before = self._filter.position
        score = self._filter.correct_scalar(h, innovation, variance, gate)
        self.scores[aid] = score
        if score > gate:
            self.counts[aid + "_refused"] += 1
            since_ns, count = self._refused.get(aid, (now_ns, 0))
            self._refused[aid] = (since_ns, count + 1)
            return False
        self.counts[aid + "_used"] += 1
        self._refused.pop(aid, None)
        self._announce(before, 0.0, aid, now_ns)
        return True

    def _refused_long(self, aid: str, now_ns: int) -> bool:
        since_ns, count = self._refused.get(aid, (now_ns, 0))
        return now_ns - since_ns > self._recovery_ns and count >= _REFUSED_MIN

    def _widen(self, aid: str, start: int, size: int, sigma: float, now_ns: int) -> None:
        self._filter.inflate(start, sigma, size)
        self._refused.pop(aid, None)
        self.counts[aid + "_recovered"] += 1
        self._say(now_ns, f"{aid} refused for long: uncertainty widened, it will be believed")

    def _pose_fresh(self, now_ns: int) -> bool:
        return now_ns - self.state.last_pose_ns < self._aid_fresh_ns

    def _announce(self, before: Vector3, yaw: float, cause: str, now_ns: int, always: bool = False) -> None:
        """Counts a correction as a jump if it moved the position by more than the threshold."""
        after = self._filter.position
        length_m = math.dist(after, before)
        if not always and length_m < self._config.jump_threshold_m:
            return
        state = self.state
        state.position_reset_count += 1
        state.position_jump[:] = (after[0] - before[0], after[1] - before[1], after[2] - before[2])
        state.yaw_jump = math.remainder(yaw, 2.0 * math.pi)
        state.position[:] = after
        self._say(now_ns, f"position estimate jumped {length_m:.2f} m ({cause})")

    def _say(self, now_ns: int, text: str) -> None:
        if len(self._events) < 64:
            self._events.append((now_ns, text))


def _softened(variance: float, off: float, near: float, gate: float) -> float:
    """The variance with which a measurement off by sqrt(`off`) passes the gate, if that is no more than `near`."""
    return max(variance, off / gate) if off <= near * near else variance
