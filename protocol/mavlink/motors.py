"""Onboard to vehicle: HIL_ACTUATOR_CONTROLS with the thrust of each motor, 0..1 of its maximum, in PX4 quad-X order."""

from typing import Final

from pymavlink.dialects.v20 import common as mavlink

from protocol.mavlink.frames import Fields, Message
from protocol.mavlink.status import ARMED

MOTORS: Final[int] = mavlink.MAVLINK_MSG_ID_HIL_ACTUATOR_CONTROLS
Fractions = tuple[float, float, float, float]
OFF: Final[Fractions] = (0.0, 0.0, 0.0, 0.0)
_UNUSED: Final = (0.0,) * 12


def clip(fraction: float) -> float:
    """The nearest value in 0..1."""
    return min(max(fraction, 0.0), 1.0)


def encode_motors(time_us: int, fractions: Fractions, armed: bool) -> Message:
    """Motor command."""
    fields = (time_us, 0, *fractions, *_UNUSED, ARMED if armed else 0)
    return Message(mavlink.MAVLink_hil_actuator_controls_message, fields)


def decode_motors(f: Fields) -> tuple[Fractions, bool]:
    """Fractions as sent (they may be outside 0..1 or not finite), and whether armed."""
    # time_usec, flags, controls 16, mode
    return f[2:6], bool(f[18] & ARMED)
