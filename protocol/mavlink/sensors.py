"""Vehicle to onboard: inertial sensors and pressure, optical flow, distance to the floor.

The simulated vehicle encodes; onboard/links/vehicle.py decodes. Both sides use the same axes (body FRD); only units and
field order differ. Decoded readings carry the vehicle's clock, which VehicleLink replaces by the onboard clock.
"""

from typing import Final, NamedTuple

from pymavlink.dialects.v20 import common as mavlink

from protocol.geometry import Vector3
from protocol.mavlink.frames import Fields, Message

IMU: Final[int] = mavlink.MAVLINK_MSG_ID_HIL_SENSOR
FLOWS: Final = (mavlink.MAVLINK_MSG_ID_HIL_OPTICAL_FLOW, mavlink.MAVLINK_MSG_ID_OPTICAL_FLOW_RAD)
"""Two messages with the same fields."""
RANGE: Final[int] = mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR

_INERTIAL_FIELDS: Final = 0b111_111
"""Bits of HIL_SENSOR.fields_updated: three accelerometers, three gyroscopes."""
_PRESSURE_FIELD: Final[int] = mavlink.HIL_SENSOR_UPDATED_ABS_PRESSURE
_SENT_FIELDS: Final[int] = _INERTIAL_FIELDS | _PRESSURE_FIELD | mavlink.HIL_SENSOR_UPDATED_TEMPERATURE
_TEMPERATURE_C: Final = 25.0
_TEMPERATURE_CENTI_C: Final = 2500
_DOWN: Final[int] = mavlink.MAV_SENSOR_ROTATION_PITCH_270
_MICROSECONDS_MAX: Final = 2**63 // 1000


class ImuReading(NamedTuple):
    """HIL_SENSOR."""

    time_ns: int
    """When the sample was taken."""
    accelerometer: Vector3
    """Specific force, m/s^2, body FRD: (0, 0, -9.81) at rest on level ground."""
    gyroscope: Vector3
    """Angular rate, rad/s, body FRD."""
    pressure_pa: float | None = None
    """None if the sample has no pressure."""


def encode_imu(time_us: int, accelerometer: Vector3, gyroscope: Vector3, pressure_pa: float) -> Message:
    """HIL_SENSOR with pressure; magnetometer, differential pressure and altitude are 0 and not marked as updated."""
    air = (pressure_pa * 0.01, 0.0, 0.0, _TEMPERATURE_C)
    fields = (time_us, *accelerometer, *gyroscope, 0.0, 0.0, 0.0, *air, _SENT_FIELDS)
    return Message(mavlink.MAVLink_hil_sensor_message, fields)


def decode_imu(f: Fields) -> ImuReading | None:
    """None if an inertial axis is missing, the sample is of a second IMU, or its time is too large."""
    # time_usec, accelerometer 3, gyroscope 3, magnetometer 3, abs_pressure (hPa), ..., fields_updated, id
    if f[14] & _INERTIAL_FIELDS != _INERTIAL_FIELDS or f[15] or f[0] > _MICROSECONDS_MAX:
        return None
    return ImuReading(f[0] * 1000, f[1:4], f[4:7], f[10] * 100.0 if f[14] & _PRESSURE_FIELD else None)


class FlowReading(NamedTuple):
    """HIL_OPTICAL_FLOW of the downward camera over `integration_s`, which ends at `time_ns`.

    MAVLink's signs: a right-hand rotation about an axis gives positive flow about it; motion along +y gives negative
    `flow_x`, motion along +x positive `flow_y`. Both contain the camera's own rotation.
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


def encode_flow(
    time_us: int, integration_s: float, flow_rad: tuple[float, float], rotation_rad: Vector3, quality: int
) -> Message:
    """HIL_OPTICAL_FLOW without a distance (-1: unknown)."""
    angles = (*flow_rad, *rotation_rad)
    fields = (time_us, round(integration_s * 1e6), *angles, 0, -1.0, _TEMPERATURE_CENTI_C, 0, quality)
    return Message(mavlink.MAVLink_hil_optical_flow_message, fields)


def decode_flow(f: Fields) -> FlowReading | None:
    """None if the time is too large."""
    # time_usec, integration_time_us, x, y, xgyro, ygyro, zgyro, time_delta, distance, temperature, sensor_id, quality
    if f[0] > _MICROSECONDS_MAX:
        return None
    return FlowReading(f[0] * 1000, f[1] * 1e-6, f[2], f[3], f[4], f[5], f[11])


class RangeReading(NamedTuple):
    """DISTANCE_SENSOR: distance to the floor along body +z."""

    time_ns: int
    distance_m: float
    least_m: float = 0.0
    """The least distance that the sensor can measure."""


def encode_range(time_us: int, distance_m: float, limits_m: tuple[float, float], noise_m: float) -> Message:
    """DISTANCE_SENSOR of an ultrasonic sensor that looks down; distances in whole cm, time in ms, 32 bits."""
    centimetres = (round(limits_m[0] * 100), round(limits_m[1] * 100), round(distance_m * 100))
    variance_cm2 = min(254, round((noise_m * 100) ** 2))
    sensor = (mavlink.MAV_DISTANCE_SENSOR_ULTRASOUND, 0, _DOWN, variance_cm2)
    return Message(mavlink.MAVLink_distance_sensor_message, (time_us // 1000 & 0xFFFFFFFF, *centimetres, *sensor))


def decode_range(f: Fields) -> RangeReading | None:
    """None if the sensor does not look down."""
    # time_boot_ms, min, max, current (cm), type, id, orientation, ...
    return RangeReading(f[0] * 1_000_000, f[3] * 0.01, f[1] * 0.01) if f[6] == _DOWN else None


SensorReading = ImuReading | FlowReading | RangeReading
