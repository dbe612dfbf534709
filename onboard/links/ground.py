"""The link to a ground station: MAVLink 2 telemetry out, commands in. QGroundControl and MAVProxy understand it.

At most one message is sent in a tick, so telemetry never makes a tick long: answers and texts first, then the periodic
message that is most overdue.

A command is answered after the core has decided (`acknowledge`). A repeated command (the station did not receive the
answer) is answered again but not executed again. Requests for what onboard does not have are refused at once, because
a station without an answer waits for seconds.
"""

from collections import Counter, deque
from typing import Final, NamedTuple

from pydantic import Field
from pymavlink.dialects.v20 import common as mavlink

from configs.loader import ConfigRecord
from onboard.estimation.state import VehicleState
from onboard.flight.modes import SPINNING, Command, FlightMode
from protocol.conventions import NEVER_NS
from protocol.mavlink import ground as wire
from protocol.mavlink.frames import AvailableModes, Frame, FrameReader, FrameWriter, Message
from protocol.mavlink.signing import SigningClock
from protocol.mavlink.vehicle import HEARTBEAT, BatteryReading, encode_heartbeat, encode_system_status

ACCEPTED: Final[int] = mavlink.MAV_RESULT_ACCEPTED
REFUSED: Final[int] = mavlink.MAV_RESULT_TEMPORARILY_REJECTED
UNSUPPORTED: Final[int] = mavlink.MAV_RESULT_UNSUPPORTED
FORCE: Final = 21196.0
"""Second parameter of COMPONENT_ARM_DISARM that disarms in flight too."""
QUEUE_MAX: Final = 32
"""Texts and answers that may wait; older ones are dropped."""
REPEAT_NS: Final = 5 * 10**9
FLOAT32_MAX: Final = 3.4e38
STAGGER_NS: Final = 5_000_000
MODE_NAMES: Final = {int(mode): mode.name for mode in FlightMode}
"""By the custom mode of HEARTBEAT."""

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
_BASE_MODE: Final[int] = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
_SYSTEM_STATES: Final[dict[FlightMode, int]] = {
    FlightMode.BOOT: mavlink.MAV_STATE_CALIBRATING,
    FlightMode.READY: mavlink.MAV_STATE_STANDBY,
    FlightMode.LANDED: mavlink.MAV_STATE_STANDBY,
    FlightMode.HOLD: mavlink.MAV_STATE_CRITICAL,
    FlightMode.HOLD_LEVEL: mavlink.MAV_STATE_EMERGENCY,
    FlightMode.EMERGENCY: mavlink.MAV_STATE_EMERGENCY,
    FlightMode.TERMINATED: mavlink.MAV_STATE_FLIGHT_TERMINATION,
}
"""All other modes: active."""


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
    """Both directions of the link to the ground station. Bytes from the station never raise."""

    def __init__(
        self, config: GroundLinkConfig, key: bytes | None = None, signing_clock: SigningClock | None = None
    ) -> None:
        """With a `key` unsigned frames are refused, and sent frames are signed.

        Raises ValueError if the key is not 32 bytes long.
        """
        self._config = config
        requests = (wire.FILE_TRANSFER, wire.PARAMETER_LIST, wire.PARAMETER_READ, wire.MISSION_LIST)
        clock = signing_clock or SigningClock()
        self._reader = FrameReader((HEARTBEAT, wire.COMMAND_LONG, *requests), key, clock)
        self._writer = FrameWriter(config.system, config.component, key, clock)
        self._waiting: deque[Message] = deque(maxlen=QUEUE_MAX)
        self._answered: dict[tuple[int, int, int], tuple[int, int]] = {}
        self._next_value = 0
        self._text_id = 0
        rates_hz = (config.attitude_hz, config.position_hz, config.heartbeat_hz, config.status_hz, config.values_hz)
        self._periods_ns = [round(1e9 / hz) for hz in rates_hz]
        self._due_ns: list[int] | None = None
        self._soonest_ns = NEVER_NS
        """When the next periodic message is due."""
        self.values: dict[str, float] = {}
        """Named values to send (names of at most 10 characters); the core may change them at any time."""
        self.rejected: Counter[str] = self._reader.rejected
        """What was dropped, by reason."""
        self.last_received_ns = NEVER_NS

    # -- from the ground station --------------------------------------------------------------------------------------

    def receive(self, datagram: bytes, now_ns: int) -> list[GroundCommand]:
        """The commands of one datagram that the core has to decide; everything else is answered here."""
        commands: list[GroundCommand] = []
        for frame in self._reader.read(datagram, now_ns):
            if frame.system == self._config.system:
                self.rejected["own_echo"] += 1
                continue
            self.last_received_ns = now_ns
            if frame.message_id == wire.COMMAND_LONG:
                command = self._command(frame, now_ns)
                if command is not None:
                    commands.append(command)
            elif frame.message_id != HEARTBEAT:
                self._waiting.append(wire.encode_answer(frame, self._config.system))
        return commands

    def screen(self, datagram: bytes) -> int:
        """The kind of a datagram: message id of its first frame; -1 if it would be refused."""
        found = self._reader.screen(datagram)
        return -1 if found is None or found[1] == self._config.system else found[0]

    def acknowledge(self, command: GroundCommand, refusal: str, now_ns: int) -> None:
        """Answer a command: accepted if `refusal` is "", else refused with that text on the pilot's screen."""
        result = REFUSED if refusal else ACCEPTED
        if not refusal:
            self._answered[(command.mavlink_command, command.system, command.component)] = (now_ns, result)
        self._answer(command.mavlink_command, result, command.system, command.component)
        if refusal:
            self.send_text(f"refused to {command.command.value}: {refusal}", mavlink.MAV_SEVERITY_WARNING)

    def send_text(self, text: str, severity: int = mavlink.MAV_SEVERITY_INFO) -> None:
        """Put a text on the pilot's screen."""
        self._text_id = self._text_id % 0xFFFF + 1
        self._waiting += wire.encode_text(text, severity, self._text_id)

    def _command(self, frame: Frame, now_ns: int) -> GroundCommand | None:
        number, parameters, target_system, confirmation = wire.decode_command(frame.fields)
        if target_system not in (0, self._config.system):
            self.rejected["other_target"] += 1
            return None
        if number == mavlink.MAV_CMD_REQUEST_MESSAGE and parameters[0] == AvailableModes.id:
            self._send_modes(parameters[1], frame)
            return None
        command = _meaning(number, parameters)
        if command is None:
            self.rejected["command_unsupported"] += 1
            self._answer(number, UNSUPPORTED, frame.system, frame.component)
            return None
        answered_ns, result = self._answered.get((number, frame.system, frame.component), (NEVER_NS, ACCEPTED))
        if confirmation > 0 and now_ns - answered_ns < REPEAT_NS:
            self._answer(number, result, frame.system, frame.component)
            return None
        return GroundCommand(command, number, frame.system, frame.component)

    def _send_modes(self, index: float, frame: Frame) -> None:
        """Answer a request for the names of all modes (index 0), or of one."""
        known = 0.0 <= index <= len(MODE_NAMES)
        result = ACCEPTED if known else mavlink.MAV_RESULT_DENIED
        self._answer(mavlink.MAV_CMD_REQUEST_MESSAGE, result, frame.system, frame.component)
        if known:
            self._waiting += wire.encode_modes(MODE_NAMES, int(index))

    def _answer(self, number: int, result: int, system: int, component: int) -> None:
        self._waiting.append(wire.encode_acknowledgement(number, result, system, component))

    # -- to the ground station ----------------------------------------------------------------------------------------

    def is_due(self, now_ns: int) -> bool:
        """Whether `poll` has something to send, or to plan."""
        return bool(self._waiting) or now_ns >= self._soonest_ns

    def poll(self, now_ns: int, mode: FlightMode, state: VehicleState, battery: BatteryReading) -> list[bytes]:
        """At most one message, the most urgent that is due."""
        if self._waiting:
            return [self._writer.write(self._waiting.popleft(), now_ns)]
        due = self._due_ns
        if due is None:
            due = self._due_ns = [now_ns + index * STAGGER_NS for index in range(len(self._periods_ns))]
        soonest_ns = self._soonest_ns = min(due)
        if now_ns < soonest_ns:
            return []
        index = due.index(soonest_ns)
        due[index] = max(due[index] + self._period_ns(index), now_ns - self._periods_ns[index])
        self._soonest_ns = min(due)
        message = self._periodic(index, now_ns, mode, state, battery)
        if message is None:
            return []
        if any(isinstance(value, float) and not abs(value) <= FLOAT32_MAX for value in message.fields):
            self.rejected["not_finite_telemetry"] += 1
            return []
        return [self._writer.write(message, now_ns)]

    def _period_ns(self, index: int) -> int:
        """The named values share one slot; its period is shorter the more values there are."""
        return self._periods_ns[index] // max(1, len(self.values)) if index == 4 else self._periods_ns[index]

    def _periodic(
        self, index: int, now_ns: int, mode: FlightMode, state: VehicleState, battery: BatteryReading
    ) -> Message | None:
        """The message of one slot; None if there are no named values."""
        boot_ms = now_ns // 1_000_000 & 0xFFFFFFFF
        if index == 0:
            return wire.encode_attitude(boot_ms, state.quaternion.tolist(), state.rates.tolist())
        if index == 1:
            return wire.encode_position(boot_ms, state.position.tolist(), state.velocity.tolist())
        if index == 2:
            system_state = _SYSTEM_STATES.get(mode, mavlink.MAV_STATE_ACTIVE)
            return encode_heartbeat(mode, mavlink.MAV_AUTOPILOT_GENERIC, _BASE_MODE, mode in SPINNING, system_state)
        if index == 3:
            present = _INERTIAL | _ALWAYS | _POSE | _HEIGHT | _PREARM
            healthy = self._healthy(now_ns, mode, state)
            return encode_system_status(present, healthy, battery.voltage_v, battery.remaining)
        if not self.values:
            return None
        names = list(self.values)
        name = names[self._next_value % len(names)]
        self._next_value += 1
        return wire.encode_named_value(boot_ms, name, self.values[name])

    def _healthy(self, now_ns: int, mode: FlightMode, state: VehicleState) -> int:
        """Bits of the sensors and controls that work."""
        healthy = _ALWAYS
        if now_ns - state.last_imu_ns <= self._config.imu_fresh_s * 1e9:
            healthy |= _INERTIAL
        if now_ns - state.last_pose_ns <= self._config.pose_fresh_s * 1e9:
            healthy |= _POSE
        if state.height_valid:
            healthy |= _HEIGHT
        if mode is FlightMode.READY or mode in SPINNING:
            healthy |= _PREARM
        return healthy


def _meaning(number: int, parameters: tuple[float, ...]) -> Command | None:
    """The command that a MAV_CMD and its first two parameters stand for; None if onboard does not have it."""
    first, second = parameters[:2]
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
