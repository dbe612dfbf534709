"""Onboard to ground station and back: telemetry, texts and answers out, commands and requests in.

SI units, world NED and body FRD on the wire as in this project. HEARTBEAT and SYS_STATUS: status.py.
"""

from collections.abc import Mapping
from typing import Final, NamedTuple

from pymavlink.dialects.v20 import common as mavlink

from protocol.mavlink.frames import AvailableModes, Fields, Frame, Message

COMMAND_LONG: Final[int] = mavlink.MAVLINK_MSG_ID_COMMAND_LONG
FILE_TRANSFER: Final[int] = mavlink.MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL
PARAMETER_LIST: Final[int] = mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_LIST
PARAMETER_READ: Final[int] = mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_READ
MISSION_LIST: Final[int] = mavlink.MAVLINK_MSG_ID_MISSION_REQUEST_LIST

TEXT_BYTES: Final = 50
TEXT_CHUNKS_MAX: Final = 3
_NAME_BYTES: Final = 10
_PARAMETER: Final = b"SYS_ID"
_FTP_NACK: Final = 129
_FTP_UNKNOWN_COMMAND: Final = 7


NOT_SELECTABLE: Final = 2
"""MAV_MODE_PROPERTY_NOT_USER_SELECTABLE."""
_MODE_NAME_BYTES: Final = 34


class CommandLong(NamedTuple):
    """COMMAND_LONG."""

    number: int
    """MAV_CMD."""
    parameters: tuple[float, ...]
    """[7]."""
    target_system: int
    """0: every vehicle."""
    confirmation: int
    """Larger than 0 when the station repeats the command."""


def decode_command(f: Fields) -> CommandLong:
    """COMMAND_LONG."""
    # seven parameters, command, target_system, target_component, confirmation
    return CommandLong(f[7], f[:7], f[8], f[10])


def encode_attitude(time_ms: int, quaternion: Fields, rates_rad_s: Fields) -> Message:
    """ATTITUDE_QUATERNION, wxyz, body to world."""
    fields = (time_ms, *quaternion, *rates_rad_s, 0.0, 0.0, 0.0, 0.0)
    return Message(mavlink.MAVLink_attitude_quaternion_message, fields)


def encode_position(time_ms: int, position_ned_m: Fields, velocity_ned_m_s: Fields) -> Message:
    """LOCAL_POSITION_NED."""
    return Message(mavlink.MAVLink_local_position_ned_message, (time_ms, *position_ned_m, *velocity_ned_m_s))


def encode_named_value(time_ms: int, name: str, value: float) -> Message:
    """NAMED_VALUE_FLOAT; the name is cut to 10 characters."""
    fields = (time_ms, value, name.encode("ascii", "replace")[:_NAME_BYTES])
    return Message(mavlink.MAVLink_named_value_float_message, fields)


def encode_text(text: str, severity: int, text_id: int) -> list[Message]:
    """STATUSTEXT, in up to three chunks of 50 characters. `text_id`: not 0; it joins the chunks of one text."""
    data = text.encode("ascii", "replace")[: TEXT_BYTES * TEXT_CHUNKS_MAX]
    chunks = [data[at : at + TEXT_BYTES] for at in range(0, max(1, len(data)), TEXT_BYTES)]
    number = text_id if len(chunks) > 1 else 0
    kind = mavlink.MAVLink_statustext_message
    return [Message(kind, (severity, chunk, number, index)) for index, chunk in enumerate(chunks)]


def encode_modes(names: Mapping[int, str], only: int = 0) -> list[Message]:
    """AVAILABLE_MODES for each mode, or for the one with the index `only` (from 1). No mode can be selected.

    names: by the number that HEARTBEAT has as custom mode.
    """
    numbered = enumerate(names.items(), start=1)
    return [
        Message(
            AvailableModes,
            (mode, NOT_SELECTABLE, len(names), index, 0, name.encode("ascii", "replace")[:_MODE_NAME_BYTES]),
        )
        for index, (mode, name) in numbered
        if only in (0, index)
    ]


def encode_acknowledgement(number: int, result: int, system: int, component: int) -> Message:
    """COMMAND_ACK to one station. `number`: MAV_CMD; `result`: MAV_RESULT."""
    return Message(mavlink.MAVLink_command_ack_message, (number, result, 0, 0, system, component))


def encode_answer(request: Frame, own_system: int) -> Message:
    """The shortest answer to a request for something that onboard does not have.

    File transfer is refused, the mission is empty, and the only parameter is the system id.
    """
    f, station = request.fields, (request.system, request.component)
    if request.message_id == FILE_TRANSFER:
        # target network, system, component, payload 251: sequence 2, session, operation, ...
        sequence = (f[3] | f[4] << 8) + 1 & 0xFFFF
        nack = bytearray(251)
        nack[0:2] = sequence.to_bytes(2, "little")
        nack[2:6] = bytes((f[5], _FTP_NACK, 1, f[6]))
        nack[12] = _FTP_UNKNOWN_COMMAND
        return Message(mavlink.MAVLink_file_transfer_protocol_message, (0, *station, *nack))
    if request.message_id == MISSION_LIST:
        return Message(mavlink.MAVLink_mission_count_message, (0, *station, 0))
    fields = (float(own_system), 1, 0, _PARAMETER, mavlink.MAV_PARAM_TYPE_REAL32)
    return Message(mavlink.MAVLink_param_value_message, fields)
