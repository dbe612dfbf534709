"""Estimates position, velocity and attitude from IMU, relayed pose, optical flow, ultrasonic range and pressure.

error_state_filter.py is the filter; this file decides which measurements it gets.

  start       at rest: roll and pitch from the accelerometer, gyro bias from the gyroscope, yaw and position 0. Without
              any pose this stays the origin
  calibration at rest, motors off: calibration.py; the mean rate is the gyro bias, the mean specific force is gravity
              plus the accelerometer's bias. What of it is bias and what is tilt the covariance decides: with the
              attitude of a pose it is bias, without any pose almost all of it is tilt, and the horizontal bias is 0
  on ground   velocity is zero, the gyroscope reads its bias, height is zero unless a pose measures it
  pose        pose_fusion.py
  flow        body velocity = flow rate times distance to the floor along the camera's axis
  range       height over the floor at d = 0; nothing below the sensor's least distance
  pressure    height against the pressure at the start; weak
  no aid      velocity is zero within a few m/s, which keeps the attitude level
"""

import math
from typing import Final

import numpy as np

from onboard.estimation.calibration import BenchCalibration, Calibration
from onboard.estimation.config import EstimatorConfig
from onboard.estimation.corrections import Corrections
from onboard.estimation.error_state_filter import (
    ACCELEROMETER_BIAS,
    ATTITUDE,
    GYRO_BIAS,
    POSITION,
    VELOCITY,
    ErrorStateFilter,
)
from onboard.estimation.imu_conditioning import AXES, StillStart, VibrationMeter
from onboard.estimation.pose_fusion import PoseFusion
from onboard.estimation.state import VehicleState
from onboard.estimation.stuck_gyro import Found, StuckGyro
from protocol.conventions import GRAVITY, NEVER_NS, Array
from protocol.geometry import ZERO, Vector3, matrix_times, quaternion_of, vector
from protocol.mavlink.vehicle import FlowReading, ImuReading, RangeReading, SensorReading
from protocol.messages import Pose

AIR_PA_PER_M: Final = 11.6
"""Pressure per metre of height at 20 degrees C near sea level."""
SLOW_AIDS: Final = 8
"""Each slow aid is fused every eighth IMU sample, at 25 Hz, one after the other."""
PRESSURE_TURN: Final = 7
COS_TILT_MIN: Final = 0.7
"""Flow and range count only at less tilt than this."""
RATE_SIGMA: Final = 0.3
"""rad/s, of the rate of a stuck axis when it is found."""
TURN_SIGMA: Final = 0.03
"""rad, of the attitude then."""
GAP_MAX_S: Final = 0.1
"""The IMU is integrated over no longer gap than this."""


class Estimator:
    """Estimates the state of the vehicle. Readings must come in the order of their arrival."""

    def __init__(self, config: EstimatorConfig) -> None:
        self.state = VehicleState()
        """The state after the newest reading; always the same object, overwritten in place."""
        self._config = config
        self._filter = ErrorStateFilter(config.covariance_every)
        self._corrections = Corrections(config, self._filter, self.state)
        self.counts, self.scores = self._corrections.counts, self._corrections.scores
        self._gyro = StuckGyro(config.gyro_stuck_samples, config.gyro_stuck_disturbance_s)
        self._poses = PoseFusion(config, self._filter, self.state, self._corrections, self._gyro)
        self._aid_fresh_ns = int(config.aid_fresh_s * 1e9)
        self._recovery_ns = int(config.recovery_s * 1e9)
        self._bias_before: Vector3 = ZERO
        self._h_flow: Array = np.zeros(15)
        self._on_ground = self._at_rest = True
        self.calibration = BenchCalibration(config)
        """Of the IMU, on the bench; `refusal` is why the vehicle must not be armed yet."""
        self._start = StillStart(config.start_samples, config.start_rate_max_rad_s)
        self._vibration = VibrationMeter()
        self._turn = 0
        self._pressure_sum, self._pressure_count = 0.0, 0
        self._pressure_zero_pa = 0.0

    @property
    def covariance(self) -> Array:
        """[15, 15], of (position, velocity, world attitude error, gyro bias, accelerometer bias); a view."""
        return self._filter.P

    @property
    def healthy(self) -> bool:
        """Whether all numbers are finite. If not, the state must not be used any more."""
        f = self._filter
        return math.isfinite(sum(f.position) + sum(f.velocity) + sum(f.quaternion) + sum(f.gyro_bias))

    def set_on_ground(self, on_ground: bool, at_rest: bool = False) -> None:
        """Whether the vehicle is on the floor. There its velocity and height are known.

        at_rest: its motors are off as well, and have been for a while. Then its IMU is calibrated.
        """
        self._on_ground = on_ground
        if at_rest is not self._at_rest:
            self._at_rest = at_rest
            self.calibration.interrupt()
        self._corrections.in_flight = not on_ground

    @property
    def mean_scores(self) -> dict[str, float]:
        """Mean NIS of each aid in flight, 1 where its sigmas fit. Pressure: against a height known better."""
        return self._corrections.mean_scores

    @property
    def gyro_stuck(self) -> bool:
        """Whether an axis of the gyroscope is stuck. Its rate then comes from the motors, and the flight should end."""
        return bool(self._gyro.axes)

    def expect_turn(self, u_hat: Array, residual: Array, dt: float) -> None:
        """[3] each: angular acceleration by the motors over the last `dt`, and the rest of it, rad/s^2, body FRD."""
        self._gyro.expect(vector(u_hat.tolist()), vector(residual.tolist()), dt)

    def take_events(self) -> list[tuple[int, str]]:
        """Return and clear the events since the last call: (time_ns, text)."""
        return self._corrections.take_events()

    def receive(self, reading: SensorReading) -> None:
        """Fuse one reading of a sensor of the vehicle."""
        if isinstance(reading, ImuReading):
            self._receive_imu(reading)
        elif isinstance(reading, FlowReading):
            self._receive_flow(reading)
        else:
            self._receive_range(reading)

    def receive_pose(self, pose: Pose, capture_ns: int, now_ns: int, time_sigma_s: float = 0.0) -> None:
        """Fuse a pose of the motion capture that was true at `capture_ns` (onboard clock) and arrived at `now_ns`.

        time_sigma_s: standard deviation of `capture_ns`, s, if it is more than the configured one.
        """
        if self.state.initialised:
            self._poses.receive(pose, capture_ns, now_ns, time_sigma_s)

    # -- inertial sensors ---------------------------------------------------------------------------------------------

    def _receive_imu(self, reading: ImuReading) -> None:
        state = self.state
        dt = (reading.time_ns - state.last_imu_ns) * 1e-9
        if dt <= 0.0:
            self.counts["imu_out_of_order"] += 1
            return
        first = state.last_imu_ns == NEVER_NS
        state.last_imu_ns = reading.time_ns
        if self._at_rest:
            self._calibrate(reading)
        if not state.initialised:
            self._find_start(reading)
            return
        if first or dt > self._config.gap_s:
            dt = self._bridge_gap(reading.time_ns, dt)
        state.vibration = self._vibration.update(reading.accelerometer, dt)
        reading = self._with_good_rates(reading, dt)
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
        self._turn = (self._turn + 1) % SLOW_AIDS
        self._fuse_slow_aid(self._turn, reading)
        state.publish(self._filter, reading)
        state.height_valid = reading.time_ns - state.last_height_ns < 2 * self._aid_fresh_ns
        if self._turn == 0:
            state.publish_sigmas(self._filter)

    def _with_good_rates(self, reading: ImuReading, dt: float) -> ImuReading:
        """The reading, with the rate of a stuck axis replaced by one from the motors."""
        gyro, f = self._gyro, self._filter
        for found in gyro.receive(reading.gyroscope, reading.accelerometer, dt, not self._on_ground):
            self._lose_axis(found, reading.time_ns)
        if not gyro.axes:
            return reading
        if self._on_ground:
            f.gyro_bias = self._bias_before
            gyro.reset()
            return reading
        for axis in gyro.axes:
            f.inflate(GYRO_BIAS + axis, self._config.gyro_stuck_walk * math.sqrt(dt), 1)
        gyro.note_bias(f.gyro_bias, reading.time_ns, dt)
        return reading._replace(gyroscope=gyro.replaced(reading.gyroscope))

    def _lose_axis(self, found: Found, now_ns: int) -> None:
        """Undo what a stuck axis has done to the attitude, and report it."""
        turn = [0.0, 0.0, 0.0]
        turn[found.axis] = found.turn_rad
        f = self._filter
        if self._gyro.axes == [found.axis]:
            self._bias_before = f.gyro_bias
        f.shift(ZERO, ZERO, matrix_times(f.rotation, vector(turn)))
        f.inflate(GYRO_BIAS + found.axis, RATE_SIGMA, 1)
        f.inflate(ATTITUDE, TURN_SIGMA)
        self._corrections.report(
            now_ns, f"gyroscope {AXES[found.axis]} stuck: its rate comes from the motors from now on"
        )

    def _find_start(self, reading: ImuReading) -> None:
        """Wait for still samples in a row, then set attitude and gyro bias from their means."""
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
        angles = f"roll {math.degrees(roll):.1f}, pitch {math.degrees(pitch):.1f} deg"
        self._corrections.report(reading.time_ns, f"attitude found: {angles}")
        self.state.publish(self._filter, reading)

    def _calibrate(self, reading: ImuReading) -> None:
        """Collect a sample at rest; use a calibration that it completes."""
        bench = self.calibration
        known, text = bench.accepted, bench.add(reading)
        if text:
            self._corrections.report(reading.time_ns, text)
        if bench.accepted is not None and bench.accepted is not known:
            self._use_calibration(bench.accepted)

    def _use_calibration(self, found: Calibration) -> None:
        """The gyro bias as found; specific force = gravity + bias as a measurement of tilt and accelerometer bias.

        f = R^T a + b with a = (0, 0, -g): innovation f + g R^T e_d - b = R^T [a]x phi + db + noise. On the bench a
        sample has up to three times the noise of `accelerometer_sigma`.
        """
        config, f = self._config, self._filter
        share = 1.0 / math.sqrt(found.samples)
        f.gyro_bias = found.rate
        f.restart_error(GYRO_BIAS, config.gyro_sigma * share)
        f.restart_error(ACCELEROMETER_BIAS, config.start_accelerometer_bias_sigma)  # no sample may count twice
        for axis in range(3):
            h: Array = np.zeros(15)
            to_north, to_east, to_down = f.rotation[axis], f.rotation[3 + axis], f.rotation[6 + axis]
            h[ATTITUDE : ATTITUDE + 2] = -GRAVITY * to_east, GRAVITY * to_north
            h[ACCELEROMETER_BIAS + axis] = 1.0
            innovation = found.force[axis] + GRAVITY * to_down - f.accelerometer_bias[axis]
            f.correct_scalar(h, innovation, (3.0 * config.accelerometer_sigma * share) ** 2, math.inf)

    def _bridge_gap(self, time_ns: int, gap_s: float) -> float:
        """Increase the uncertainty after missing IMU samples; returns the time step to integrate over."""
        self.counts["imu_gap"] += 1
        self._poses.trust.blind = True
        seconds = min(gap_s, 5.0)
        self._filter.inflate(VELOCITY, 3.0 * seconds)
        self._filter.inflate(POSITION, 1.5 * seconds * seconds)
        self._filter.inflate(ATTITUDE, 0.5 * seconds)
        self._corrections.report(time_ns, f"IMU gap of {gap_s * 1e3:.0f} ms")
        return min(gap_s, GAP_MAX_S)

    # -- slow aids ----------------------------------------------------------------------------------------------------

    def _fuse_slow_aid(self, turn: int, reading: ImuReading) -> None:
        now_ns = reading.time_ns
        if turn == PRESSURE_TURN:
            self._fuse_pressure(now_ns)
        elif self._on_ground:
            self._fuse_ground(turn, reading)
        elif turn < 3 and now_ns - self.state.last_velocity_aid_ns > self._recovery_ns:
            variance = self._config.unaided_velocity_sigma_m_s**2
            self._filter.correct_scalar(VELOCITY + turn, -self._filter.velocity[turn], variance, math.inf)

    def _fuse_ground(self, turn: int, reading: ImuReading) -> None:
        """On the ground: velocity 0, rate = bias, height 0."""
        config, f = self._config, self._filter
        self.state.last_velocity_aid_ns = reading.time_ns
        if turn < 3:
            f.correct_scalar(VELOCITY + turn, -f.velocity[turn], config.still_velocity_sigma_m_s**2, math.inf)
        elif turn < 6:
            axis = turn - 3
            innovation = reading.gyroscope[axis] - f.gyro_bias[axis]
            if abs(innovation) < config.start_rate_max_rad_s:  # else a person is carrying the vehicle
                f.correct_scalar(GYRO_BIAS + axis, innovation, (3.0 * config.gyro_sigma) ** 2, math.inf)
        elif reading.time_ns - self.state.last_pose_ns > self._recovery_ns:
            f.correct_scalar(POSITION + 2, -f.position[2], config.still_height_sigma_m**2, math.inf)

    def _fuse_pressure(self, now_ns: int) -> None:
        """Height from pressure. While a better height is known, the zero of the pressure follows it instead."""
        if not self._pressure_count:
            return
        pressure_pa = self._pressure_sum / self._pressure_count
        self._pressure_sum, self._pressure_count = 0.0, 0
        zero_pa = pressure_pa - AIR_PA_PER_M * self._filter.position[2]
        if not self._pressure_zero_pa:
            self._pressure_zero_pa = zero_pa
        config, off_pa = self._config, zero_pa - self._pressure_zero_pa
        self._poses.trust.note_pressure(off_pa / AIR_PA_PER_M, now_ns)
        if self._on_ground or now_ns - self.state.last_height_ns < self._aid_fresh_ns:
            self._corrections.note_score("pressure", (off_pa / config.pressure_sigma_pa) ** 2, config.pressure_gate)
            self._pressure_zero_pa += 0.02 * off_pa
            return
        # Means of neighbouring samples have the same drift, so they count as one independent value a second.
        sigma_m = 5.0 * math.hypot(config.pressure_sigma_pa, config.pressure_drift_pa) / AIR_PA_PER_M
        innovation_m, gate = off_pa / AIR_PA_PER_M, config.pressure_gate
        self._corrections.correct("pressure", POSITION + 2, innovation_m, sigma_m**2, gate, now_ns)

    # -- optical flow and range ---------------------------------------------------------------------------------------

    def _receive_flow(self, reading: FlowReading) -> None:
        """Velocity over ground from optical flow, two scalars in the body frame at the middle of the exposure.

        v_x = d (flow_y - rotation_y) / dt, v_y = -d (flow_x - rotation_x) / dt, d the distance along body z;
        measured v_b = R^T v: error R^T dv + R^T [v]x phi.
        """
        config, f, now_ns = self._config, self._filter, reading.time_ns
        if not self.state.initialised or self._on_ground or reading.quality < config.flow_quality_min:
            return
        past = f.at(now_ns - int(0.5e9 * reading.integration_s))
        if past is None or past.rotation[8] < COS_TILT_MIN:
            return
        distance_m = -past.position[2] / past.rotation[8]
        if distance_m < config.flow_height_min_m:
            return
        scale = distance_m / reading.integration_s
        rotation_x, rotation_y = self._flow_rotation(reading)
        measured = (scale * (reading.flow_y - rotation_y), -scale * (reading.flow_x - rotation_x))
        vx, vy, vz = past.velocity
        R, h = past.rotation, self._h_flow
        used, residual = True, [0.0, 0.0]
        for axis in (0, 1):
            rx, ry, rz = R[axis], R[3 + axis], R[6 + axis]
            expected = rx * vx + ry * vy + rz * vz
            h[3], h[4], h[5] = rx, ry, rz
            h[9], h[10] = self._flow_of_lost_rate(axis, distance_m)
            h[6], h[7], h[8] = ry * vz - rz * vy, rz * vx - rx * vz, rx * vy - ry * vx
            sigma = config.flow_rate_sigma_rad_s * distance_m + config.flow_scale_sigma * abs(expected)
            innovation = residual[axis] = measured[axis] - expected
            used &= self._corrections.correct("flow", h, innovation, sigma * sigma, config.flow_gate, now_ns)
        if used:
            self.state.last_velocity_aid_ns = max(now_ns, self.state.last_velocity_aid_ns)
        else:
            self._recover("flow", VELOCITY, 3, now_ns)
        self._poses.trust.note_flow((residual[0], residual[1]), R, now_ns)
        self._poses.check_drift(now_ns)

    def _flow_rotation(self, reading: FlowReading) -> tuple[float, float]:
        """The rotation in the flow, rad. It comes from the gyroscope, so that of a stuck axis is replaced as well."""
        x, y = reading.rotation_x, reading.rotation_y
        if 0 in self._gyro.axes:
            x = float(self.state.rates[0]) * reading.integration_s
        if 1 in self._gyro.axes:
            y = float(self.state.rates[1]) * reading.integration_s
        return x, y

    def _flow_of_lost_rate(self, axis: int, distance_m: float) -> tuple[float, float]:
        """What an error of the biases about x and y adds to a body velocity by the flow, m/s per rad/s.

        Only that of a stuck axis matters: v_x = d (flow_y - q + b_y), v_y = -d (flow_x - p + b_x), with p and q of the
        gyroscope. So the flow measures that rate.
        """
        if axis == 0:
            return 0.0, -distance_m if 1 in self._gyro.axes else 0.0
        return distance_m if 0 in self._gyro.axes else 0.0, 0.0

    def _receive_range(self, reading: RangeReading) -> None:
        """Height from the ultrasonic sensor over a level floor at d = 0.

        The first echo comes from straight below while the tilt is within the beam's cone, from its edge beyond it.
        """
        config, now_ns = self._config, reading.time_ns
        past = self._filter.at(now_ns) if self.state.initialised else None
        valid = config.range_floor_m + config.range_margin_m < reading.distance_m < config.range_max_m
        if past is None or self._on_ground or not valid or past.rotation[8] < COS_TILT_MIN:
            return
        beyond = math.acos(min(1.0, past.rotation[8])) - config.range_half_cone_rad
        down_m = -reading.distance_m * (math.cos(beyond) if beyond > 0.0 else 1.0)
        innovation = down_m - past.position[2]
        variance, gate = config.range_sigma_m**2, config.range_gate
        if self._corrections.correct("range", POSITION + 2, innovation, variance, gate, now_ns):
            self.state.last_height_ns = now_ns
        else:
            self._recover("range", POSITION + 2, 1, now_ns)
        self._poses.trust.note_range(down_m, innovation, now_ns)
        self._poses.check_drift(now_ns)

    def _recover(self, aid: str, start: int, size: int, now_ns: int) -> None:
        """After long refusal of an aid without a fresh pose: increase the uncertainty, so that it is accepted again."""
        pose_fresh = now_ns - self.state.last_pose_ns < self._aid_fresh_ns
        if self._corrections.refused_long(aid, now_ns) and not pose_fresh:
            self._corrections.widen(aid, start, size, 1.0, now_ns)
