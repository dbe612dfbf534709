"""The wire to a ground station: MAVLink 2 telemetry out, commands in. QGroundControl and MAVProxy understand it.

At most one message leaves in a tick, so that telemetry never makes a tick long: answers and texts first, then the
periodic message that is most overdue.

A command is answered once the core has said what became of it (`acknowledge`). A repeated one (the station did not
hear our answer) is answered again without being carried out again. Things a ground station asks for and we do not
have are refused at once, because a station that gets no answer waits for seconds: MAVLink FTP gets a NACK, the
parameter list has one entry, the mission is empty.
"""

import math
from collections import Counter, deque
from typing import Any, Final, NamedTuple

from pydantic import Field
from pymavlink.dialects.v20 import common as mavlink

from configs.loader import ConfigRecord
from onboard.estimation.state import VehicleState
from onboard.flight.modes import SPINNING, Command, FlightMode
from onboard.links.readings import BatteryReading
from protocol.conventions import NEVER_NS
from protocol.mavlink_frames import Frame, FrameReader, FrameWriter, SigningClock

HEARTBEAT: Final[int] = mavlink.MAVLINK_MSG_ID_HEARTBEAT
COMMAND_LONG: Final[int] = mavlink.MAVLINK_MSG_ID_COMMAND_LONG
FILE_TRANSFER: Final[int] = mavlink.MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL
PARAM_REQUEST_LIST: Final[int] = mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_LIST
PARAM_REQUEST_READ: Final[int] = mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_READ
MISSION_REQUEST_LIST: Final[int] = mavlink.MAVLINK_MSG_ID_MISSION_REQUEST_LIST

ACCEPTED: Final[int] = mavlink.MAV_RESULT_ACCEPTED
REFUSED: Final[int] = mavlink.MAV_RESULT_TEMPORARILY_REJECTED
UNSUPPORTED: Final[int] = mavlink.MAV_RESULT_UNSUPPORTED
FORCE: Final = 21196.0
"""COMPONENT_ARM_DISARM's magic second parameter: disarm in flight too."""
NO_OPINION: Final = 0xFFFF
TEXT_BYTES: Final = 50
TEXT_CHUNKS_MAX: Final = 3
QUEUE_MAX: Final = 32
"""Texts and answers that may wait; older ones are dropped."""
REPEAT_NS: Final = 5 * 10**9
NAME_BYTES: Final = 10
PARAMETER: Final = b"SYS_ID"
FLOAT32_MAX: Final = 3.4e38

_FTP_NACK: Final = 129
_FTP_UNKNOWN_COMMAND: Final = 7
_INERTIAL: Final[int] = mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
_ALWAYS: Final[int] = (
    mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | mavlink.MAV_SYS_STATUS_SENSOR_ATTITUDE_STABILIZATION
    | mavlink.MAV_SYS_STATUS_SENSOR_YAW_POSITION
    | mavlink.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS
    | mavlink.MAV_SYS_STATUS_GEOFENCE
)
_POSE: Final[int] = mavlink.MAV_SYS_STATUS_SENSOR_VISION_POSITION | mavlink.MAV_SYS_STATUS_SENSOR_XY_POSITION_CONTROL
_HEIGHT: Final[int] = mavlink.MAV_SYS_STATUS_SENSOR_Z_ALTITUDE_CONTROL
_PREARM: Final[int] = mavlink.MAV_SYS_STATUS_PREARM_CHECK
_SYSTEM_STATES: Final[dict[FlightMode, int]] = {
    FlightMode.BOOT: mavlink.MAV_STATE_CALIBRATING,
    FlightMode.READY: mavlink.MAV_STATE_STANDBY,
    FlightMode.LANDED: mavlink.MAV_STATE_STANDBY,
    FlightMode.HOLD: mavlink.MAV_STATE_CRITICAL,
    FlightMode.HOLD_LEVEL: mavlink.MAV_STATE_EMERGENCY,
    FlightMode.EMERGENCY: mavlink.MAV_STATE_EMERGENCY,
    FlightMode.TERMINATED: mavlink.MAV_STATE_FLIGHT_TERMINATION,
}
"""All others: active."""


class GroundLinkConfig(ConfigRecord):
    """Rates of the telemetry."""

    system: int = Field(default=1, ge=1, le=255, description="MAVLink system id of this vehicle")
    component: int = Field(default=1, ge=1, le=255, description="MAVLink component id: autopilot")
    attitude_hz: float = Field(default=10.0, gt=0, le=50, description="Hz")
    position_hz: float = Field(default=10.0, gt=0, le=50, description="Hz")
    heartbeat_hz: float = Field(default=1.0, gt=0, le=10, description="Hz")
    status_hz: float = Field(default=2.0, gt=0, le=10, description="Hz")
    values_hz: float = Field(default=2.0, gt=0, le=10, description="Hz, of each named value")
    pose_fresh_s: float = Field(default=0.5, gt=0, description="s; an older pose is shown as unhealthy")
    imu_fresh_s: float = Field(default=0.05, gt=0, description="s; older inertial sensors are shown as unhealthy")


class GroundCommand(NamedTuple):
    """A command of a ground station, to be answered by GroundLink.acknowledge."""

    command: Command
    mavlink_command: int
    system: int
    component: int


class GroundLink:
    """Both directions of the ground station's wire. Never raises on what the station sends."""

    def __init__(
        self, config: GroundLinkConfig, key: bytes | None = None, signing_clock: SigningClock | None = None
    ) -> None:
        """With a `key` only signed frames count, and ours are signed.

        Raises ValueError if it is not 32 bytes long.
        """
        self._config = config
        ids = (HEARTBEAT, COMMAND_LONG, FILE_TRANSFER, PARAM_REQUEST_LIST, PARAM_REQUEST_READ, MISSION_REQUEST_LIST)
        clock = signing_clock or SigningClock()
        self._reader = FrameReader(ids, key, clock)
        self._writer = FrameWriter(config.system, config.component, key, clock)
        self._waiting: deque[tuple[Any, tuple[Any, ...]]] = deque(maxlen=QUEUE_MAX)
        self._answered: dict[tuple[int, int, int], tuple[int, int]] = {}
        self._next_value = 0
        self._text_id = 0
        self._periods_ns = [
            round(1e9 / hz)
            for hz in (
                config.attitude_hz,
                config.position_hz,
                config.heartbeat_hz,
                config.status_hz,
                config.values_hz,
            )
        ]
        self._due_ns: list[int] | None = None
        self.values: dict[str, float] = {}
        """Named values to show (names of at most 10 characters); the core writes them whenever it likes."""
        self.rejected: Counter[str] = self._reader.rejected
        """What was dropped, by reason."""
        self.last_received_ns = NEVER_NS

    # -- from the ground station --------------------------------------------------------------------------------------

    def receive(self, datagram: bytes, now_ns: int) -> list[GroundCommand]:
        """The commands of one datagram that the core has to judge; everything else is answered here."""
        commands: list[GroundCommand] = []
        for frame in self._reader.read(datagram, now_ns):
            if frame.system == self._config.system:
                self.rejected["own_echo"] += 1
                continue
            self.last_received_ns = now_ns
            if frame.message_id == COMMAND_LONG:
                command = self._command(frame, now_ns)
                if command is not None:
                    commands.append(command)
            elif frame.message_id != HEARTBEAT:
                self._answer_request(frame)
        return commands

    def acknowledge(self, command: GroundCommand, refusal: str, now_ns: int) -> None:
        """Answers a command: accepted when `refusal` is "", else refused with that text shown to the pilot."""
        result = REFUSED if refusal else ACCEPTED
        if not refusal:
            self._answered[(command.mavlink_command, command.system, command.component)] = (now_ns, result)
        self._put_ack(command.mavlink_command, result, command.system, command.component)
        if refusal:
            self.send_text(f"refused to {command.command.value}: {refusal}", mavlink.MAV_SEVERITY_WARNING)

    def send_text(self, text: str, severity: int = mavlink.MAV_SEVERITY_INFO) -> None:
        """Puts a text on the pilot's screen, in chunks of 50 characters."""
        data = text.encode("ascii", "replace")[: TEXT_BYTES * TEXT_CHUNKS_MAX]
        self._text_id = self._text_id % 0xFFFF + 1
        text_id = self._text_id if len(data) > TEXT_BYTES else 0
        for index in range(max(1, math.ceil(len(data) / TEXT_BYTES))):
            chunk = data[index * TEXT_BYTES : (index + 1) * TEXT_BYTES]
            self._waiting.append((mavlink.MAVLink_statustext_message, (severity, chunk, text_id, index)))

    def _command(self, frame: Frame, now_ns: int) -> GroundCommand | None:
        f = frame.fields  # seven parameters, command, target system, target component, confirmation
        if f[8] not in (0, self._config.system):
            self.rejected["other_target"] += 1
            return None
        number = f[7]
        command = _meaning(number, f[0], f[1])
        if command is None:
            self.rejected["command_unsupported"] += 1
            self._put_ack(number, UNSUPPORTED, frame.system, frame.component)
            return None
        answered_ns, result = self._answered.get((number, frame.system, frame.component), (NEVER_NS, ACCEPTED))
        if f[10] > 0 and now_ns - answered_ns < REPEAT_NS:
            self._put_ack(number, result, frame.system, frame.component)
            return None
        return GroundCommand(command, number, frame.system, frame.component)

    def _answer_request(self, frame: Frame) -> None:
        """Requests for things that we do not have: the shortest answer that lets the station go on."""
        f = frame.fields
        if frame.message_id == FILE_TRANSFER:
            sequence = (f[3] | f[4] << 8) + 1 & 0xFFFF
            nack = bytearray(251)
            nack[0:2] = sequence.to_bytes(2, "little")
            nack[2:6] = bytes((f[5], _FTP_NACK, 1, f[6]))
            nack[12] = _FTP_UNKNOWN_COMMAND
            self._waiting.append(
                (mavlink.MAVLink_file_transfer_protocol_message, (0, frame.system, frame.component, *nack))
            )
        elif frame.message_id == MISSION_REQUEST_LIST:
            self._waiting.append((mavlink.MAVLink_mission_count_message, (0, frame.system, frame.component, 0)))
        else:
            kind = mavlink.MAV_PARAM_TYPE_REAL32
            fields = (float(self._config.system), 1, 0, PARAMETER, kind)
            self._waiting.append((mavlink.MAVLink_param_value_message, fields))

    def _put_ack(self, number: int, result: int, system: int, component: int) -> None:
        self._waiting.append((mavlink.MAVLink_command_ack_message, (number, result, 0, 0, system, component)))

    # -- to the ground station ----------------------------------------------------------------------------------------

    def poll(self, now_ns: int, mode: FlightMode, state: VehicleState, battery: BatteryReading) -> list[bytes]:
        """At most one message, the most urgent that is due."""
        if self._waiting:
            kind, fields = self._waiting.popleft()
            return [self._writer.write(kind, fields, now_ns)]
        due = self._due_ns
        if due is None:
            due = self._due_ns = [now_ns + index * 5_000_000 for index in range(len(self._periods_ns))]
        soonest_ns = min(due)
        if now_ns < soonest_ns:
            return []
        index = due.index(soonest_ns)
        due[index] = max(due[index] + self._period_ns(index), now_ns - self._periods_ns[index])
        return self._periodic(index, now_ns, mode, state, battery)

    def _period_ns(self, index: int) -> int:
        """Named values share one slot, which comes round more often the more there are."""
        return self._periods_ns[index] // max(1, len(self.values)) if index == 4 else self._periods_ns[index]

    def _periodic(
        self, index: int, now_ns: int, mode: FlightMode, state: VehicleState, battery: BatteryReading
    ) -> list[bytes]:
        boot_ms = now_ns // 1_000_000 & 0xFFFFFFFF
        kind: Any
        fields: tuple[Any, ...]
        if index == 0:
            kind = mavlink.MAVLink_attitude_quaternion_message
            fields = (boot_ms, *state.quaternion.tolist(), *state.rates.tolist(), 0.0, 0.0, 0.0, 0.0)
        elif index == 1:
            kind = mavlink.MAVLink_local_position_ned_message
            fields = (boot_ms, *state.position.tolist(), *state.velocity.tolist())
        elif index == 2:
            kind, fields = mavlink.MAVLink_heartbeat_message, self._heartbeat(mode)
        elif index == 3:
            kind, fields = mavlink.MAVLink_sys_status_message, self._system_status(now_ns, mode, state, battery)
        elif self.values:
            names = list(self.values)
            name = names[self._next_value % len(names)]
            self._next_value += 1
            kind = mavlink.MAVLink_named_value_float_message
            fields = (boot_ms, self.values[name], name.encode("ascii", "replace")[:NAME_BYTES])
        else:
            return []
        if any(isinstance(value, float) and not abs(value) <= FLOAT32_MAX for value in fields):
            self.rejected["not_finite_telemetry"] += 1
            return []
        return [self._writer.write(kind, fields, now_ns)]

    def _heartbeat(self, mode: FlightMode) -> tuple[Any, ...]:
        base = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
        if mode in SPINNING:
            base |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        status = _SYSTEM_STATES.get(mode, mavlink.MAV_STATE_ACTIVE)
        return (int(mode), mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_GENERIC, base, status, 3)

    def _system_status(
        self, now_ns: int, mode: FlightMode, state: VehicleState, battery: BatteryReading
    ) -> tuple[Any, ...]:
        present = _INERTIAL | _ALWAYS | _POSE | _HEIGHT | _PREARM
        health = _ALWAYS
        if now_ns - state.last_imu_ns <= self._config.imu_fresh_s * 1e9:
            health |= _INERTIAL
        if now_ns - state.last_pose_ns <= self._config.pose_fresh_s * 1e9:
            health |= _POSE
        if state.height_valid:
            health |= _HEIGHT
        if mode is FlightMode.READY or mode in SPINNING:
            health |= _PREARM
        millivolts = min(round(battery.voltage_v * 1000), NO_OPINION - 1) if battery.voltage_v > 0.0 else NO_OPINION
        percent = round(battery.remaining * 100) if battery.remaining >= 0.0 else -1
        return (present, present, health, 0, millivolts, -1, 0, 0, 0, 0, 0, 0, percent, 0, 0, 0)


def _meaning(number: int, first: float, second: float) -> Command | None:
    """What a MAV_CMD and its first two parameters ask for; None when we cannot do it."""
    if number == mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
        if first == 1.0:
            return Command.ARM
        if first == 0.0:
            return Command.TERMINATE if second == FORCE else Command.DISARM
        return None
    if number == mavlink.MAV_CMD_NAV_TAKEOFF:
        return Command.TAKE_OFF
    if number == mavlink.MAV_CMD_NAV_LAND:
        return Command.LAND
    if number == mavlink.MAV_CMD_DO_FLIGHTTERMINATION and first > 0.5:
        return Command.TERMINATE
    return None
