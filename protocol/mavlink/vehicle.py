"""Vehicle to onboard: inertial sensors, optical flow, distance, battery, heartbeat. Onboard to vehicle: motors.

The simulated vehicle is one end, onboard/links/vehicle.py the other. Both use the axes (body FRD) and the motor order
(PX4 quad-X) of the messages; only units and field order differ. Decoded readings carry the vehicle's clock, which
VehicleLink replaces by the onboard clock. HEARTBEAT and SYS_STATUS are also sent to a ground station.
"""

from typing import Final, NamedTuple

from pymavlink.dialects.v20 import common as mavlink

from protocol.geometry import Vector3
from protocol.mavlink.frames import Fields, FixedFields, Message
from protocol.named_tuple import of_members

IMU: Final[int] = mavlink.MAVLINK_MSG_ID_HIL_SENSOR
FLOWS: Final = (mavlink.MAVLINK_MSG_ID_HIL_OPTICAL_FLOW, mavlink.MAVLINK_MSG_ID_OPTICAL_FLOW_RAD)
"""Two messages with the same fields."""
VELOCITY_FLOW: Final[int] = mavlink.MAVLINK_MSG_ID_OPTICAL_FLOW
RANGE: Final[int] = mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR
HEARTBEAT: Final[int] = mavlink.MAVLINK_MSG_ID_HEARTBEAT
BATTERY_STATUS: Final[int] = mavlink.MAVLINK_MSG_ID_BATTERY_STATUS
SYSTEM_STATUS: Final[int] = mavlink.MAVLINK_MSG_ID_SYS_STATUS
MOTORS: Final[int] = mavlink.MAVLINK_MSG_ID_HIL_ACTUATOR_CONTROLS
ARMED: Final[int] = mavlink.MAV_MODE_FLAG_SAFETY_ARMED
_INERTIAL_FIELDS: Final = 0b111_111
"""Bits of HIL_SENSOR.fields_updated: three accelerometers, three gyroscopes."""
_PRESSURE_FIELD: Final[int] = mavlink.HIL_SENSOR_UPDATED_ABS_PRESSURE
_SENT_FIELDS: Final[int] = _INERTIAL_FIELDS | _PRESSURE_FIELD | mavlink.HIL_SENSOR_UPDATED_TEMPERATURE
_TEMPERATURE_C: Final = 25.0
_TEMPERATURE_CENTI_C: Final = 2500
_DOWN: Final[int] = mavlink.MAV_SENSOR_ROTATION_PITCH_270
_MAVLINK_VERSION: Final = 3
_UNKNOWN_MV: Final = 0xFFFF
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


_imu_reading: Final = of_members(ImuReading)
_message: Final = of_members(Message)


def encode_imu(time_us: int, accelerometer: Vector3, gyroscope: Vector3, pressure_pa: float) -> Message:
    """HIL_SENSOR with pressure; magnetometer, differential pressure and altitude are 0 and not marked as updated."""
    air = (pressure_pa * 0.01, 0.0, 0.0, _TEMPERATURE_C)
    fields = (time_us, *accelerometer, *gyroscope, 0.0, 0.0, 0.0, *air, _SENT_FIELDS)
    return _message((mavlink.MAVLink_hil_sensor_message, fields, None))


def decode_imu(f: Fields) -> ImuReading | None:
    """None if an inertial axis is missing, the sample is of a second IMU, or its time is too large."""
    # time_usec, accelerometer 3, gyroscope 3, magnetometer 3, abs_pressure (hPa), ..., fields_updated, id
    if f[14] & _INERTIAL_FIELDS != _INERTIAL_FIELDS or f[15] or f[0] > _MICROSECONDS_MAX:
        return None
    return _imu_reading((f[0] * 1000, f[1:4], f[4:7], f[10] * 100.0 if f[14] & _PRESSURE_FIELD else None))


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
    return _message((mavlink.MAVLink_hil_optical_flow_message, fields, None))


def decode_flow(f: Fields) -> FlowReading | None:
    """None if the time is too large."""
    # time_usec, integration_time_us, x, y, xgyro, ygyro, zgyro, time_delta, distance, temperature, sensor_id, quality
    if f[0] > _MICROSECONDS_MAX:
        return None
    return FlowReading(f[0] * 1000, f[1] * 1e-6, f[2], f[3], f[4], f[5], f[11])


class VelocityFlow(NamedTuple):
    """OPTICAL_FLOW: velocity over ground, without the camera's rotation, at a distance."""

    time_ns: int
    velocity_x: float
    """m/s, along body x."""
    velocity_y: float
    """m/s, along body y."""
    distance_m: float
    """To the floor along body +z; it was used to find the velocity."""
    quality: int
    """0 (worst) to 255."""

    def over(self, integration_s: float, rate: Vector3) -> FlowReading:
        """The angles that a camera sees that turns with this rate, rad/s, for a time that ends at `time_ns`."""
        rotation_x, rotation_y = rate[0] * integration_s, rate[1] * integration_s
        angle = integration_s / self.distance_m
        flow_x, flow_y = rotation_x - self.velocity_y * angle, rotation_y + self.velocity_x * angle
        return FlowReading(self.time_ns, integration_s, flow_x, flow_y, rotation_x, rotation_y, self.quality)


def decode_velocity_flow(f: Fields) -> VelocityFlow | None:
    """None if the time is too large or the distance is unknown: without it the velocity says nothing about angles."""
    # time_usec, flow_comp_m_x, flow_comp_m_y, ground_distance, flow_x, flow_y (pixels), sensor_id, quality, ...
    if f[0] > _MICROSECONDS_MAX or not f[3] > 0.0:
        return None
    return VelocityFlow(f[0] * 1000, f[1], f[2], f[3], f[7])


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


# -- heartbeat and battery -------------------------------------------------------------------------------------------


class BatteryReading(NamedTuple):
    """BATTERY_STATUS or SYS_STATUS: the battery under load."""

    time_ns: int
    """Arrival: these messages carry no time."""
    voltage_v: float
    """0 if unknown."""
    remaining: float
    """Fraction 0..1; negative if unknown."""


def encode_heartbeat(custom_mode: int, autopilot: int, base_mode: int, armed: bool, state: int) -> Message:
    """HEARTBEAT of a quadrotor."""
    mode = base_mode | ARMED if armed else base_mode
    fields = (custom_mode, mavlink.MAV_TYPE_QUADROTOR, autopilot, mode, state, _MAVLINK_VERSION)
    return Message(mavlink.MAVLink_heartbeat_message, fields)


def encode_battery(voltage_v: float, current_a: float, used_mah: float, remaining: float) -> Message:
    """BATTERY_STATUS of one lithium cell: mV, 10 mA, mAh, per cent."""
    cells_mv = (_millivolts(voltage_v), *(_UNKNOWN_MV,) * 9)
    kind = (0, mavlink.MAV_BATTERY_FUNCTION_ALL, mavlink.MAV_BATTERY_TYPE_LIPO)
    current_ca = min(32767, round(current_a * 100))
    fields = (round(used_mah), -1, _TEMPERATURE_CENTI_C, *cells_mv, current_ca, *kind, _percent(remaining))
    return Message(mavlink.MAVLink_battery_status_message, fields)


def decode_battery(f: Fields, now_ns: int) -> BatteryReading:
    """The sum of the cells whose voltage is known."""
    # current_consumed, energy_consumed, temperature, voltages 10 (mV), current, id, function, type, remaining (%)
    return _reading(now_ns, sum(cell for cell in f[3:13] if cell != _UNKNOWN_MV), f[17])


def encode_system_status(present: int, healthy: int, voltage_v: float, remaining: float) -> Message:
    """SYS_STATUS: sensors that are present (all enabled) and healthy, and the battery."""
    fields = (present, present, healthy, 0, _millivolts(voltage_v), -1, 0, 0, 0, 0, 0, 0, _percent(remaining), 0, 0, 0)
    return Message(mavlink.MAVLink_sys_status_message, fields)


def decode_system_status(f: Fields, now_ns: int) -> BatteryReading:
    """The battery's part of SYS_STATUS."""
    # three sensor masks, load, voltage (mV), current, six counters, remaining (%)
    return _reading(now_ns, 0 if f[4] == _UNKNOWN_MV else f[4], f[12])


def _reading(now_ns: int, millivolts: int, percent: int) -> BatteryReading:
    return BatteryReading(now_ns, millivolts * 1e-3, percent * 0.01 if percent >= 0 else -1.0)


def _millivolts(voltage_v: float) -> int:
    return min(round(voltage_v * 1000), _UNKNOWN_MV - 1) if voltage_v > 0.0 else _UNKNOWN_MV


def _percent(remaining: float) -> int:
    return round(100 * min(remaining, 1.0)) if remaining >= 0.0 else -1


# -- motors -----------------------------------------------------------------------------------------------------------

Fractions = tuple[float, float, float, float]
OFF: Final[Fractions] = (0.0, 0.0, 0.0, 0.0)
_ARMED: Final = FixedFields(mavlink.MAVLink_hil_actuator_controls_message, (*(0.0,) * 12, ARMED))
_DISARMED: Final = FixedFields(mavlink.MAVLink_hil_actuator_controls_message, (*(0.0,) * 12, 0))
"""The unused controls, and the mode."""


def clip(fraction: float) -> float:
    """The nearest value in 0..1."""
    return min(max(fraction, 0.0), 1.0)


def encode_motors(time_us: int, fractions: Fractions, armed: bool) -> Message:
    """Motor command."""
    kind, fixed = mavlink.MAVLink_hil_actuator_controls_message, _ARMED if armed else _DISARMED
    return _message((kind, (time_us, 0, *fractions), fixed))


def decode_motors(f: Fields) -> tuple[Fractions, bool]:
    """Fractions as sent (they may be outside 0..1 or not finite), and whether armed."""
    # time_usec, flags, controls 16, mode
    return f[2:6], bool(f[18] & ARMED)
