"""The estimated state of the vehicle: one record, overwritten with every IMU sample."""

import math
from dataclasses import dataclass, field

import numpy as np

from onboard.estimation.error_state_filter import ErrorStateFilter
from protocol.conventions import NEVER_NS, Array
from protocol.geometry import euler_of, tilt_angle
from protocol.mavlink.vehicle import ImuReading


def _zeros() -> Array:
    return np.zeros(3)


@dataclass(slots=True, eq=False)
class VehicleState:
    """The vehicle's state now. The arrays belong to the estimator, which overwrites them with every IMU sample."""

    time_ns: int = 0
    """Time of the newest IMU sample, onboard clock."""
    position: Array = field(default_factory=_zeros)
    """m, world NED."""
    velocity: Array = field(default_factory=_zeros)
    """m/s, world NED."""
    quaternion: Array = field(default_factory=lambda: np.array([1.0, 0.0, 0.0, 0.0]))
    """wxyz, body FRD to world NED."""
    rotation: Array = field(default_factory=lambda: np.eye(3))
    """[3, 3], body FRD to world NED."""
    euler: Array = field(default_factory=_zeros)
    """Roll, pitch, yaw, rad (yaw-pitch-roll sequence)."""
    rates: Array = field(default_factory=_zeros)
    """rad/s, body FRD, bias removed."""
    specific_force: Array = field(default_factory=_zeros)
    """m/s^2, body FRD, bias removed."""
    gyro_bias: Array = field(default_factory=_zeros)
    """rad/s."""
    accelerometer_bias: Array = field(default_factory=_zeros)
    """m/s^2."""
    position_sigma_m: float = 0.0
    """Largest horizontal standard deviation of the position estimate."""
    velocity_sigma_m_s: float = 0.0
    """Largest standard deviation of the velocity estimate."""
    vibration: float = 0.0
    """m/s^2, magnitude of the high-passed accelerometer, smoothed."""
    tilt_rad: float = 0.0
    """Angle between body z and world z."""
    height_valid: bool = False
    """Height was recently corrected by pose or ultrasonic range."""
    initialised: bool = False
    """Attitude is known; before that the state must not be used."""
    position_reset_count: int = 0
    """Number of jumps of the position estimate; a controller shifts its own references with them."""
    position_jump: Array = field(default_factory=_zeros)
    """m, world NED: new minus old position at the latest jump."""
    yaw_jump: float = 0.0
    """rad: new minus old yaw at the latest jump."""
    last_imu_ns: int = NEVER_NS
    last_pose_ns: int = NEVER_NS
    """Arrival of the newest pose that was accepted, onboard clock."""
    last_velocity_aid_ns: int = NEVER_NS
    """Newest accepted pose or flow, onboard clock."""
    last_height_ns: int = NEVER_NS
    """Newest accepted pose or range, onboard clock."""

    def publish(self, source: ErrorStateFilter, reading: ImuReading) -> None:
        """Copy everything that changes with an IMU sample, element by element for speed."""
        self.time_ns = reading.time_ns
        out = self.position
        out[0], out[1], out[2] = source.position
        out = self.velocity
        out[0], out[1], out[2] = source.velocity
        bx, by, bz = source.gyro_bias
        gx, gy, gz = reading.gyroscope
        out = self.rates
        out[0], out[1], out[2] = gx - bx, gy - by, gz - bz
        out = self.gyro_bias
        out[0], out[1], out[2] = bx, by, bz
        bx, by, bz = source.accelerometer_bias
        ax, ay, az = reading.accelerometer
        out = self.specific_force
        out[0], out[1], out[2] = ax - bx, ay - by, az - bz
        out = self.accelerometer_bias
        out[0], out[1], out[2] = bx, by, bz
        self.publish_attitude(source)

    def publish_attitude(self, source: ErrorStateFilter) -> None:
        """Copy quaternion, rotation matrix, Euler angles and tilt."""
        q, r, rotation = self.quaternion, self.rotation, source.rotation
        q[0], q[1], q[2], q[3] = source.quaternion
        r[0, 0], r[0, 1], r[0, 2], r[1, 0], r[1, 1], r[1, 2], r[2, 0], r[2, 1], r[2, 2] = rotation
        euler = self.euler
        euler[0], euler[1], euler[2] = euler_of(rotation)
        self.tilt_rad = tilt_angle(rotation[8])

    def publish_sigmas(self, source: ErrorStateFilter) -> None:
        """Copy the standard deviations of position and velocity."""
        n, e, _, vn, ve, vd = source.P.diagonal()[:6].tolist()
        self.position_sigma_m = math.sqrt(max(n, e, 0.0))
        self.velocity_sigma_m_s = math.sqrt(max(vn, ve, vd, 0.0))
