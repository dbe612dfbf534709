"""The estimated state of the vehicle: one record, overwritten with every IMU sample."""

import numpy as np

from protocol.conventions import NEVER_NS, Array


class VehicleState:
    """The vehicle's state now. The arrays belong to the estimator, which overwrites them with every IMU sample."""

    __slots__ = (
        "accelerometer_bias",
        "euler",
        "gyro_bias",
        "height_valid",
        "initialised",
        "last_height_ns",
        "last_imu_ns",
        "last_pose_ns",
        "last_velocity_aid_ns",
        "position",
        "position_jump",
        "position_reset_count",
        "position_sigma_m",
        "quaternion",
        "rates",
        "rotation",
        "specific_force",
        "tilt_rad",
        "time_ns",
        "velocity",
        "velocity_sigma_m_s",
        "vibration",
        "yaw_jump",
    )

    def __init__(self) -> None:
        self.time_ns = 0
        """Time of the newest IMU sample, onboard clock."""
        self.position: Array = np.zeros(3)
        """m, world NED."""
        self.velocity: Array = np.zeros(3)
        """m/s, world NED."""
        self.quaternion: Array = np.array([1.0, 0.0, 0.0, 0.0])
        """wxyz, body FRD to world NED."""
        self.rotation: Array = np.eye(3)
        """[3, 3], body FRD to world NED."""
        self.euler: Array = np.zeros(3)
        """Roll, pitch, yaw, rad (yaw-pitch-roll sequence)."""
        self.rates: Array = np.zeros(3)
        """rad/s, body FRD, bias removed."""
        self.specific_force: Array = np.zeros(3)
        """m/s^2, body FRD, bias removed."""
        self.gyro_bias: Array = np.zeros(3)
        """rad/s."""
        self.accelerometer_bias: Array = np.zeros(3)
        """m/s^2."""
        self.position_sigma_m = 0.0
        """Largest horizontal standard deviation of the position estimate."""
        self.velocity_sigma_m_s = 0.0
        """Largest standard deviation of the velocity estimate."""
        self.vibration = 0.0
        """m/s^2, magnitude of the high-passed accelerometer, smoothed."""
        self.tilt_rad = 0.0
        """Angle between body z and world z."""
        self.height_valid = False
        """Height was recently corrected by pose or ultrasonic range."""
        self.initialised = False
        """Attitude is known; before that the state must not be used."""
        self.position_reset_count = 0
        """Number of jumps of the position estimate; a controller shifts its own references with them."""
        self.position_jump: Array = np.zeros(3)
        """m, world NED: new minus old position at the latest jump."""
        self.yaw_jump = 0.0
        """rad: new minus old yaw at the latest jump."""
        self.last_imu_ns = NEVER_NS
        self.last_pose_ns = NEVER_NS
        """Arrival of the newest pose that was accepted, onboard clock."""
        self.last_velocity_aid_ns = NEVER_NS
        """Newest accepted pose or flow, onboard clock."""
        self.last_height_ns = NEVER_NS
        """Newest accepted pose or range, onboard clock."""
