"""Supervisor: chooses the flight mode by the table in modes.py.

In every step the row of the present mode is read from the left, and the first event whose condition is true decides.
Some conditions must be true without a break, in one mode, for a given time. The time limits of a descent count from
the last progress, so a descent from any height ends on the floor.

Reactions in flight when an input is silent: IMU, 50 ms: motors off. Velocity aid (pose or flow), 2 s: level and
descend. Pose, 0.5 s: hold the place on flow, or fly on while the estimate is good enough (`on_pose_stale`). An axis of
the gyroscope that is stuck: land. Battery report, ground station: land, if configured. Offboard: a message only.
"""

import math
from collections import deque
from collections.abc import Callable
from typing import Final, Literal, NamedTuple

from pydantic import Field

from configs.loader import ConfigRecord
from onboard.flight.modes import COMMAND_EVENTS, TRANSITIONS, Command, Event, FlightMode

__all__ = ["Command", "FlightMode", "Supervisor", "SupervisorConfig", "SupervisorInputs"]


M, E = FlightMode, Event
LEVEL_MAX_RAD: Final = 0.35
"""A vehicle with more tilt is not armed."""
_QUEUE_MAX: Final = 8
"""Commands that may wait for the next steps."""
_DESCENDING: Final = frozenset({M.HOLD_LEVEL, M.LANDING})
_PROGRESS_M: Final = 0.05
"""A descent that gets lower by this has made progress: its time limit starts again."""
_NOT_READY_NS: Final = 2 * 10**9
"""A reason against arming that lasts this long is reported."""


class SupervisorConfig(ConfigRecord):
    """Limits. Ages are seconds since the newest good input."""

    imu_silent_s: float = Field(default=0.05, gt=0, description="s; motors off")
    pose_stale_s: float = Field(default=0.5, gt=0, description="s; an older pose does not count")
    on_pose_stale: Literal["hold", "continue"] = Field(
        default="hold", description="hold: stop on flow; continue: fly on while flow and position_sigma_m are good"
    )
    position_sigma_max_m: float = Field(default=0.5, gt=0, description="m; limit for continue")
    velocity_stale_s: float = Field(default=0.5, gt=0, description="s; an older flow does not count")
    velocity_lost_s: float = Field(default=2.0, gt=0, description="s; level and descend")
    offboard_silent_s: float = Field(default=1.0, gt=0, description="s; a message only")
    ground_silent_s: float = Field(default=0.0, ge=0, description="s; landing; 0: not needed")
    battery_silent_s: float = Field(default=0.0, ge=0, description="s; landing; 0: not needed")
    battery_low_v: float = Field(default=3.2, gt=0, description="V under load; landing")
    battery_low_remaining: float = Field(default=0.1, ge=0, le=1, description="fraction; landing")
    battery_low_for_s: float = Field(default=1.0, ge=0, description="s for which the battery must be low")
    battery_arm_v: float = Field(default=3.5, gt=0, description="V; no arming below")
    battery_max_v: float = Field(default=4.5, gt=0, description="V; no arming above: wrong unit or cell count")
    tilt_max_rad: float = Field(default=1.4, gt=0, lt=math.pi, description="rad; motors off")
    fence_m: float = Field(default=10.0, gt=0, description="m from the origin, horizontally; landing")
    ceiling_m: float = Field(default=5.0, gt=0, description="m above the floor; landing")
    take_off_height_m: float = Field(default=1.0, gt=0, description="m above the floor")
    take_off_tolerance_m: float = Field(default=0.15, gt=0, description="m below that height: take-off is complete")
    take_off_max_s: float = Field(default=8.0, gt=0, description="s; then landing")
    armed_max_s: float = Field(default=10.0, gt=0, description="s on the ground with idle motors; then disarmed")
    hold_max_s: float = Field(default=20.0, gt=0, description="s on flow alone; then landing")
    level_max_s: float = Field(default=8.0, gt=0, description="s of level descent without progress; then motors off")
    landing_max_s: float = Field(default=20.0, gt=0, description="s without getting lower; then level descent")
    landed_s: float = Field(default=1.0, gt=0, description="s after touch-down until the next flight may be prepared")
    touch_down_height_m: float = Field(default=0.12, gt=0, description="m; below it and slow is touch-down")
    touch_down_speed_m_s: float = Field(default=0.15, gt=0, description="m/s")
    touch_down_thrust: float = Field(default=0.6, gt=0, lt=1, description="of weight; less and slow is touch-down too")
    touch_down_for_s: float = Field(default=0.3, ge=0, description="s for which touch-down must last")
    healthy_for_s: float = Field(default=0.5, ge=0, description="s for which all sensors must be good before arming")
    back_for_s: float = Field(default=0.3, ge=0, description="s for which a lost aid must be back")
    arm_needs_pose: bool = Field(default=True, description="no arming without a fresh pose")
    auto_arm: bool = Field(default=False, description="simulation only: arm and take off, once, when ready")


class SupervisorInputs(NamedTuple):
    """Inputs of the supervisor in one step."""

    now_ns: int
    imu_age_s: float
    pose_age_s: float
    velocity_aid_age_s: float
    offboard_age_s: float
    ground_age_s: float
    battery_age_s: float
    battery_v: float
    battery_remaining: float
    """Fraction; negative when unknown."""
    tilt_rad: float
    height_m: float
    """Above the floor."""
    climb_m_s: float
    """Positive upwards."""
    distance_m: float
    """From the origin, horizontally."""
    position_sigma_m: float
    thrust_to_weight: float
    """Collective thrust of the actuator model over weight."""
    initialised: bool
    """The attitude is known."""
    preflight: str = ""
    """Why the vehicle must not be armed; "" if it may be."""
    calibration: str = ""
    """Why the calibration of the IMU forbids arming; "" if it does not."""
    fault: bool = False
    """The estimate is not finite."""
    gyro_stuck: bool = False
    """The rate of an axis comes from the motors."""


class Supervisor:
    """Keeps the flight mode."""

    def __init__(self, config: SupervisorConfig) -> None:
        self._config = config
        self._since_ns: dict[Event, int] = {}
        self._timed_from_ns: int | None = None
        self._lowest_m = math.inf
        self._offboard_silent = True
        self._not_ready_kind = ""
        self._not_ready_since_ns = 0
        self._not_ready_reported = False
        self._flown = False
        self._inputs: SupervisorInputs | None = None
        self._queue: deque[Command] = deque(maxlen=_QUEUE_MAX)
        self._command: Command | None = None
        self._events: list[tuple[int, str]] = []
        self._lasting_ns = {
            E.HEALTHY: int(config.healthy_for_s * 1e9),
            E.POSITION_BACK: int(config.back_for_s * 1e9),
            E.VELOCITY_BACK: int(config.back_for_s * 1e9),
            E.TOUCHED_DOWN: int(config.touch_down_for_s * 1e9),
            E.BATTERY_LOW: int(config.battery_low_for_s * 1e9),
        }
        self._time_limit_ns = {
            M.ARMED: int(config.armed_max_s * 1e9),
            M.TAKE_OFF: int(config.take_off_max_s * 1e9),
            M.HOLD: int(config.hold_max_s * 1e9),
            M.HOLD_LEVEL: int(config.level_max_s * 1e9),
            M.LANDING: int(config.landing_max_s * 1e9),
            M.LANDED: int(config.landed_s * 1e9),
        }
        self.mode = M.BOOT

    @property
    def not_ready(self) -> str:
        """What the vehicle waits for on the ground before it can be armed; "" if nothing."""
        return self.arming_refusal(self._inputs) if self.mode is M.BOOT and self._inputs is not None else ""

    def take_events(self) -> list[tuple[int, str]]:
        """Return and clear the events since the last call: (time_ns, text)."""
        events, self._events = self._events, []
        return events

    def command(self, command: Command, now_ns: int) -> str:
        """Queue a command for the next step. Returns why it is refused; "" if it is accepted."""
        refusal = self._refusal(command)
        if refusal:
            self._events.append((now_ns, f"refused to {command.value}: {refusal}"))
        else:
            self._queue.append(command)
        return refusal

    def _refusal(self, command: Command) -> str:
        event = COMMAND_EVENTS[command]
        arming = command is Command.ARM
        if arming and self.mode is M.BOOT and self._inputs and (reason := self.arming_refusal(self._inputs)):
            return reason
        if all(entry is not event for entry, _ in TRANSITIONS[self.mode]):
            return f"not in mode {self.mode.name}"
        if not arming:
            return ""
        return "not running yet" if self._inputs is None else self.arming_refusal(self._inputs)

    def arming_refusal(self, inputs: SupervisorInputs) -> str:
        """The first reason to refuse arming; "" if there is none."""
        return self._sensor_refusal(inputs) or inputs.calibration

    def _sensor_refusal(self, inputs: SupervisorInputs) -> str:
        """The first reason but the calibration."""
        config = self._config
        if inputs.preflight:  # first, because a fault of the link explains the other reasons
            return inputs.preflight
        if not inputs.initialised or inputs.imu_age_s > config.imu_silent_s:
            return "IMU silent or attitude not found"
        if config.arm_needs_pose and inputs.pose_age_s > config.pose_stale_s:
            return "no fresh pose"
        if inputs.tilt_rad > LEVEL_MAX_RAD:
            return "not level"
        if inputs.battery_v > 0.0 and inputs.battery_v < config.battery_arm_v:
            return f"battery at {inputs.battery_v:.2f} V"
        if inputs.battery_v > config.battery_max_v:
            return f"battery at {inputs.battery_v:.4g} V: not one cell, or not in volts"
        if 0.0 <= inputs.battery_remaining < config.battery_low_remaining:
            return f"battery at {inputs.battery_remaining:.0%}"
        if config.battery_silent_s > 0.0 and inputs.battery_v <= 0.0:
            return "no battery report"
        if 0.0 < config.battery_silent_s < inputs.battery_age_s:
            return "battery report too old"
        if 0.0 < config.ground_silent_s < inputs.ground_age_s:
            return "no ground station"
        if inputs.distance_m > config.fence_m:
            return f"{inputs.distance_m:.1f} m from the origin, the fence is at {config.fence_m:g} m"
        return ""

    def step(self, inputs: SupervisorInputs) -> FlightMode:
        """Read the row of the present mode and make at most one transition."""
        if self._timed_from_ns is None:
            self._timed_from_ns = inputs.now_ns
        if self.mode in _DESCENDING:
            self._note_progress(inputs)
        self._inputs = inputs
        self._command = self._next_command()
        for condition, event, target in _RULES[self.mode]:
            if not condition(self, inputs):
                if self._since_ns:
                    self._since_ns.pop(event, None)
            elif self._has_lasted(event, inputs):
                self._enter(target, event, inputs)
                break
        self._report_offboard(inputs)
        if self.mode is M.BOOT:
            self._report_readiness(inputs)
        return self.mode

    def _note_progress(self, inputs: SupervisorInputs) -> None:
        """Start the time limit again when the descent has got lower. Below the floor nothing counts as progress."""
        if 0.0 < inputs.height_m < self._lowest_m - _PROGRESS_M:
            self._lowest_m = inputs.height_m
            self._timed_from_ns = inputs.now_ns

    def _next_command(self) -> Command | None:
        """The next command; termination goes before all others."""
        if not self._queue:
            return None
        if Command.TERMINATE in self._queue:
            self._queue.clear()
            return Command.TERMINATE
        return self._queue.popleft()

    def _has_lasted(self, event: Event, inputs: SupervisorInputs) -> bool:
        """Whether the condition of an event has been true long enough. The calibration runs meanwhile."""
        lasting_ns, now_ns = self._lasting_ns.get(event), inputs.now_ns
        if lasting_ns is None:
            return True
        lasted = now_ns - self._since_ns.setdefault(event, now_ns) >= lasting_ns
        return lasted and not (event is E.HEALTHY and inputs.calibration)

    def _enter(self, mode: FlightMode, event: Event, inputs: SupervisorInputs) -> None:
        why = f": {self.arming_refusal(inputs)}" if event is E.UNHEALTHY else ""
        self._events.append((inputs.now_ns, f"{self.mode.name} -> {mode.name}: {event.value}{why}"))
        self.mode = mode
        self._timed_from_ns = inputs.now_ns
        self._lowest_m = inputs.height_m
        self._since_ns.clear()
        self._not_ready_kind = ""
        if mode is M.TAKE_OFF:
            self._flown = True

    def _report_offboard(self, inputs: SupervisorInputs) -> None:
        silent = inputs.offboard_age_s > self._config.offboard_silent_s
        if silent != self._offboard_silent:
            self._offboard_silent = silent
            self._events.append((inputs.now_ns, "offboard silent" if silent else "offboard connected"))

    def _report_readiness(self, inputs: SupervisorInputs) -> None:
        """Report why the vehicle cannot be armed: each reason once (numbers apart), after it has lasted."""
        reason = self.arming_refusal(inputs)
        kind = "".join(letter for letter in reason if not letter.isdigit())
        if kind != self._not_ready_kind:
            self._not_ready_kind, self._not_ready_since_ns, self._not_ready_reported = kind, inputs.now_ns, False
        if reason and not self._not_ready_reported and inputs.now_ns - self._not_ready_since_ns >= _NOT_READY_NS:
            self._not_ready_reported = True
            self._events.append((inputs.now_ns, f"not ready to arm: {reason}"))

    # -- conditions ---------------------------------------------------------------------------------------------------

    def _healthy(self, inputs: SupervisorInputs) -> bool:
        return not self._sensor_refusal(inputs)

    def _sensors_lost(self, inputs: SupervisorInputs) -> bool:
        silent = not inputs.initialised or inputs.imu_age_s > self._config.imu_silent_s
        return silent or bool(inputs.preflight or inputs.calibration)

    def _wants_arming(self, inputs: SupervisorInputs) -> bool:
        auto = self._config.auto_arm and not self._flown
        return (auto or self._command is Command.ARM) and not self.arming_refusal(inputs)

    def _wants_take_off(self, inputs: SupervisorInputs) -> bool:
        return self._command is Command.TAKE_OFF or (self._config.auto_arm and not self._flown)

    def _position_lost(self, inputs: SupervisorInputs) -> bool:
        config = self._config
        if inputs.pose_age_s <= config.pose_stale_s:
            return False
        if config.on_pose_stale == "hold":
            return True
        carried = inputs.velocity_aid_age_s <= config.velocity_stale_s
        return not carried or inputs.position_sigma_m > config.position_sigma_max_m

    def _battery_low(self, inputs: SupervisorInputs) -> bool:
        config = self._config
        return 0.0 < inputs.battery_v < config.battery_low_v or (
            0.0 <= inputs.battery_remaining < config.battery_low_remaining
        )

    def _touched_down(self, inputs: SupervisorInputs) -> bool:
        """Not moving, and either low or with little thrust: neither can last in the air."""
        config = self._config
        if abs(inputs.climb_m_s) > config.touch_down_speed_m_s:
            return False
        return inputs.height_m < config.touch_down_height_m or inputs.thrust_to_weight < config.touch_down_thrust

    def _out_of_bounds(self, inputs: SupervisorInputs) -> bool:
        return inputs.distance_m > self._config.fence_m or inputs.height_m > self._config.ceiling_m

    def _time_up(self, inputs: SupervisorInputs) -> bool:
        assert self._timed_from_ns is not None
        return inputs.now_ns - self._timed_from_ns >= self._time_limit_ns[self.mode]

    def _at_height(self, inputs: SupervisorInputs) -> bool:
        return inputs.height_m >= self._config.take_off_height_m - self._config.take_off_tolerance_m


_CONDITIONS: Final[dict[Event, Callable[[Supervisor, SupervisorInputs], bool]]] = {
    E.TERMINATE: lambda s, i: s._command is Command.TERMINATE,
    E.IMU_SILENT_LANDED: lambda s, i: (
        i.imu_age_s > s._config.imu_silent_s and i.height_m < s._config.touch_down_height_m
    ),
    E.IMU_SILENT: lambda s, i: i.imu_age_s > s._config.imu_silent_s,
    E.FAULT: lambda s, i: i.fault,
    E.TILTED: lambda s, i: not i.tilt_rad <= s._config.tilt_max_rad,
    E.VELOCITY_LOST: lambda s, i: i.velocity_aid_age_s > s._config.velocity_lost_s,
    E.VELOCITY_BACK: lambda s, i: i.velocity_aid_age_s <= s._config.velocity_stale_s,
    E.POSITION_LOST: Supervisor._position_lost,
    E.POSITION_BACK: lambda s, i: not s._position_lost(i),
    E.GYRO_STUCK: lambda s, i: i.gyro_stuck,
    E.BATTERY_LOW: Supervisor._battery_low,
    E.BATTERY_SILENT: lambda s, i: 0.0 < s._config.battery_silent_s < i.battery_age_s,
    E.GROUND_SILENT: lambda s, i: 0.0 < s._config.ground_silent_s < i.ground_age_s,
    E.OUT_OF_BOUNDS: Supervisor._out_of_bounds,
    E.TIME_UP: Supervisor._time_up,
    E.TOUCHED_DOWN: Supervisor._touched_down,
    E.AT_HEIGHT: Supervisor._at_height,
    E.ARM: Supervisor._wants_arming,
    E.DISARM: lambda s, i: s._command is Command.DISARM,
    E.TAKE_OFF: Supervisor._wants_take_off,
    E.LAND: lambda s, i: s._command is Command.LAND,
    E.HEALTHY: Supervisor._healthy,
    E.UNHEALTHY: Supervisor._sensors_lost,
}
"""Condition of each event."""

_RULES: Final = {
    mode: tuple((_CONDITIONS[event], event, target) for event, target in row) for mode, row in TRANSITIONS.items()
}
"""The table with each event's condition: a lookup by event costs more than most conditions."""
