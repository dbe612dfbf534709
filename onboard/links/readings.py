"""Sensor readings as the vehicle link hands them to the estimator: immutable, SI units, in the onboard clock."""

from typing import NamedTuple

from protocol.geometry import Vector3


class ImuReading(NamedTuple):
    """One sample of the inertial sensors; `pressure_pa` is 0 when the sample carried none."""

    time_ns: int
    """When it was taken, in the onboard clock."""
    accelerometer: Vector3
    """Specific force, m/s^2, body FRD: (0, 0, -9.81) at rest on level ground."""
    gyroscope: Vector3
    """Angular rate, rad/s, body FRD."""
    pressure_pa: float = 0.0


class FlowReading(NamedTuple):
    """Optical flow of the downward camera over `integration_s`, which ends at `time_ns`.

    Signs as in MAVLink: a right-hand rotation about an axis gives positive flow about it; motion along +y gives
    negative `flow_x`, motion along +x positive `flow_y`. Both contain the camera's own rotation.
    """

    time_ns: int
    integration_s: float
    flow_x: float
    """rad, about body x."""
    flow_y: float
    """rad, about body y."""
    rotation_x: float
    """rad, integrated gyroscope about body x over the same time."""
    rotation_y: float
    """rad, about body y."""
    quality: int
    """0 (worst) to 255."""


class RangeReading(NamedTuple):
    """Distance to the floor along body +z, from the ultrasonic sensor."""

    time_ns: int
    distance_m: float


class BatteryReading(NamedTuple):
    """Battery under load."""

    time_ns: int
    voltage_v: float
    remaining: float
    """Fraction 0..1; negative when the vehicle does not say."""


Reading = ImuReading | FlowReading | RangeReading | BatteryReading
