"""The sensors: what they would read of the true state, with bias, noise, delay, rate and quantisation.

Optical flow keeps PX4's signs: angles are integrated about the body's axes; turning right-handed about an axis gives
positive flow about it, moving along +y gives negative flow about x, moving along +x gives positive flow about y. With
the integrated gyro taken off, v_y = -(flow_x - gyro_x)/dt * distance and v_x = (flow_y - gyro_y)/dt * distance, where
distance is measured along the body's down axis.
"""

from collections import deque
from math import acos, cos, sqrt
from typing import NamedTuple

import numpy as np

import sim_vehicle.physics.layout as at
from protocol.geometry import Quaternion
from sim_vehicle.physics.draws import NormalRows, Normals, Uniforms
from sim_vehicle.physics.parameters import FlowConfig, ImuConfig, MotionCaptureConfig, UltrasonicConfig
from sim_vehicle.records import Array
from sim_vehicle.sensors.imu import imu_settings, read_imu


class Schedule:
    """Times of a sensor that samples at the first IMU tick at or after each multiple of its period."""

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz = rate_hz
        self._count = 1
        self._due_ns = round(1e9 / rate_hz)

    def is_due(self, now_ns: int) -> bool:
        """Whether to sample now; True once for each period."""
        if now_ns < self._due_ns:
            return False
        self._count = max(self._count + 1, int(now_ns * 1e-9 * self._rate_hz + 1e-6) + 1)
        self._due_ns = round(self._count * 1e9 / self._rate_hz)
        return True


class ImuSample(NamedTuple):
    """Body FRD."""

    accelerometer_m_s2: tuple[float, float, float]
    gyroscope_rad_s: tuple[float, float, float]
    pressure_pa: float


class Imu:
    """Accelerometer (mean specific force since the last sample), delayed gyro, barometer."""

    def __init__(self, config: ImuConfig, hover_thrust_n: float, seed: int, stream: int) -> None:
        rng = np.random.default_rng([seed, stream])
        self.bias: Array = np.concatenate(
            [
                rng.standard_normal(3) * config.accelerometer_bias_sigma_m_s2,
                rng.uniform(-1.0, 1.0, 3) * config.gyroscope_bias_bound_rad_s,
                rng.standard_normal(1) * config.pressure_bias_sigma_pa,
            ]
        )
        """[7] accelerometer m/s^2, gyro rad/s, pressure Pa."""
        self._settings = imu_settings(config, hover_thrust_n)
        self._noise = NormalRows(rng, 7)
        self._reading = np.zeros(7)
        self._delayed: deque[list[float]] = deque(maxlen=config.gyroscope_delay_samples + 1)

    def sample(self, state: Array, sums: Array, shaking: Array) -> ImuSample:
        """Read the sensors; zeroes the IMU's sums. shaking: [4, 2], see World."""
        read_imu(state, sums, shaking, self.bias, self._noise.take(), self._settings, self._reading)
        ax, ay, az, *gyroscope, pressure = self._reading.tolist()
        self._delayed.append(gyroscope)
        p, q, r = self._delayed[0]
        return ImuSample((ax, ay, az), (p, q, r), pressure)


class Ultrasonic:
    """Height by ultrasound."""

    def __init__(self, config: UltrasonicConfig, seed: int, stream: int) -> None:
        self._config = config
        self.schedule = Schedule(config.rate_hz)
        rng = np.random.default_rng([seed, stream])
        self._normals, self._uniforms = Normals(rng), Uniforms(rng.spawn(1)[0])

    def sample(self, state: Array) -> float | None:
        """Distance in m along the beam, or None without an echo."""
        config = self._config
        x, y = float(state[at.QUATERNION + 1]), float(state[at.QUATERNION + 2])
        tilt = acos(max(-1.0, min(1.0, 1.0 - 2.0 * (x * x + y * y))))
        outlier, place = self._uniforms.take(), self._uniforms.take()
        noise = config.noise_m * self._normals.take()
        if outlier < config.outlier_probability:
            return config.least_m + place * (config.greatest_m - config.least_m)
        beyond = max(0.0, tilt - config.half_cone_rad)
        if beyond > 1.0:
            return None
        distance = -float(state[at.POSITION + 2]) / cos(beyond) + noise
        return None if distance > config.greatest_m else max(config.least_m, distance)


class FlowSample(NamedTuple):
    """Integrals over `time_s`, rad, PX4's signs."""

    time_s: float
    flow_rad: tuple[float, float]
    gyroscope_rad: tuple[float, float, float]
    quality: int


class Flow:
    """Optical flow camera with its own integrated gyro."""

    def __init__(self, config: FlowConfig, seed: int, stream: int) -> None:
        self._config = config
        self.schedule = Schedule(config.rate_hz)
        self._normals = Normals(np.random.default_rng([seed, stream]))

    def sample(self, state: Array, sums: Array) -> FlowSample:
        """Read the camera; zeroes the flow's sums."""
        config = self._config
        n1, n2, n3, n4, n5 = self._normals.several(5)
        time, fx, fy, gx, gy, gz = sums[at.FLOW_TIME : at.FLOW_GYRO + 3].tolist()
        sums[at.FLOW_TIME : at.FLOW_GYRO + 3] = 0.0
        noise, gyro_noise = config.noise_rad_s * time, config.gyroscope_noise_rad_s * time
        flow = (fx + noise * n1, fy + noise * n2)
        gyroscope = (gx + gyro_noise * n3, gy + gyro_noise * n4, gz + gyro_noise * n5)
        height = -float(state[at.POSITION + 2])
        rate = sqrt(fx * fx + fy * fy) / time
        sees = config.least_m <= height <= config.greatest_m and rate <= config.rate_limit_rad_s
        return FlowSample(time, flow, gyroscope, config.quality if sees else 0)


class BatterySample(NamedTuple):
    """The battery's gauge."""

    voltage_v: float
    current_a: float
    used_mah: float
    remaining: float
    """Fraction, 0..1."""


class PoseSample(NamedTuple):
    """What motion capture solved."""

    position_m: tuple[float, float, float]
    quaternion: tuple[float, float, float, float]
    velocity_m_s: tuple[float, float, float]
    """Body FRD, differences of two frames."""


class MotionCapture:
    """Motion capture of the room."""

    def __init__(self, config: MotionCaptureConfig, seed: int, stream: int) -> None:
        self.config = config
        self.schedule = Schedule(config.rate_hz)
        rng = np.random.default_rng([seed, stream])
        self._normals, self._uniforms = Normals(rng), Uniforms(rng.spawn(1)[0])
        self._last: tuple[int, tuple[float, float, float]] | None = None

    def sample(self, state: Array, now_ns: int) -> PoseSample | None:
        """The pose of this frame, or None when it is not solved."""
        config = self.config
        n1, n2, n3, n4, n5, n6 = self._normals.several(6)
        lost = self._uniforms.take() < config.loss_probability
        n, e, d, _, _, _, w, x, y, z = state[: at.RATES].tolist()
        noise = config.position_noise_m
        position = (n + noise * n1, e + noise * n2, d + noise * n3)
        noise = 0.5 * config.attitude_noise_rad
        turned = _normalised(_times((w, x, y, z), (1.0, noise * n4, noise * n5, noise * n6)))
        now_s = now_ns * 1e-9
        if lost or (config.outages and any(outage.start_s <= now_s < outage.end_s for outage in config.outages)):
            return None
        velocity = (0.0, 0.0, 0.0)
        if self._last is not None:
            dt = (now_ns - self._last[0]) * 1e-9
            (n, e, d), (was_n, was_e, was_d) = position, self._last[1]
            velocity = _unturn(turned, ((n - was_n) / dt, (e - was_e) / dt, (d - was_d) / dt))
        self._last = (now_ns, position)
        return PoseSample(position, turned, velocity)


def _times(a: Quaternion, b: Quaternion) -> Quaternion:
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


def _normalised(q: Quaternion) -> Quaternion:
    s = 1.0 / sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return (q[0] * s, q[1] * s, q[2] * s, q[3] * s)


def _unturn(q: Quaternion, v: tuple[float, float, float]) -> tuple[float, float, float]:
    """World to body."""
    inverse = (q[0], -q[1], -q[2], -q[3])
    turned = _times(_times(inverse, (0.0, *v)), q)
    return (turned[1], turned[2], turned[3])
