"""Copies the filter's tuples into the VehicleState that the other blocks read, element by element for speed."""

import math

from onboard.estimation.error_state_filter import ErrorStateFilter
from onboard.estimation.state import VehicleState
from protocol.geometry import euler_of, tilt_angle
from protocol.mavlink.sensors import ImuReading


def publish(state: VehicleState, source: ErrorStateFilter, reading: ImuReading) -> None:
    """Copy everything that changes with an IMU sample."""
    state.time_ns = reading.time_ns
    out = state.position
    out[0], out[1], out[2] = source.position
    out = state.velocity
    out[0], out[1], out[2] = source.velocity
    bx, by, bz = source.gyro_bias
    gx, gy, gz = reading.gyroscope
    out = state.rates
    out[0], out[1], out[2] = gx - bx, gy - by, gz - bz
    out = state.gyro_bias
    out[0], out[1], out[2] = bx, by, bz
    bx, by, bz = source.accelerometer_bias
    ax, ay, az = reading.accelerometer
    out = state.specific_force
    out[0], out[1], out[2] = ax - bx, ay - by, az - bz
    out = state.accelerometer_bias
    out[0], out[1], out[2] = bx, by, bz
    publish_attitude(state, source)


def publish_attitude(state: VehicleState, source: ErrorStateFilter) -> None:
    """Copy quaternion, rotation matrix, Euler angles and tilt."""
    q, r, rotation = state.quaternion, state.rotation, source.rotation
    q[0], q[1], q[2], q[3] = source.quaternion
    r[0, 0], r[0, 1], r[0, 2], r[1, 0], r[1, 1], r[1, 2], r[2, 0], r[2, 1], r[2, 2] = rotation
    euler = state.euler
    euler[0], euler[1], euler[2] = euler_of(rotation)
    state.tilt_rad = tilt_angle(rotation[8])


def publish_sigmas(state: VehicleState, source: ErrorStateFilter) -> None:
    """Copy the standard deviations of position and velocity."""
    n, e, _, vn, ve, vd = source.P.diagonal()[:6].tolist()
    state.position_sigma_m = math.sqrt(max(n, e, 0.0))
    state.velocity_sigma_m_s = math.sqrt(max(vn, ve, vd, 0.0))
