"""Heartbeat and battery: from the vehicle to onboard; HEARTBEAT and SYS_STATUS also to the ground station."""

from typing import Final, NamedTuple

from pymavlink.dialects.v20 import common as mavlink

from protocol.mavlink.frames import Fields, Message

HEARTBEAT: Final[int] = mavlink.MAVLINK_MSG_ID_HEARTBEAT
BATTERY_STATUS: Final[int] = mavlink.MAVLINK_MSG_ID_BATTERY_STATUS
SYSTEM_STATUS: Final[int] = mavlink.MAVLINK_MSG_ID_SYS_STATUS
ARMED: Final[int] = mavlink.MAV_MODE_FLAG_SAFETY_ARMED
_MAVLINK_VERSION: Final = 3
_UNKNOWN_MV: Final = 0xFFFF
_TEMPERATURE_CENTI_C: Final = 2500


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
