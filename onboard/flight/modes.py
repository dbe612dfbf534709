"""The table of flight modes: for each mode the events that end it and the next mode. supervisor.py reads it.

Each mode has a row of (event, next mode), the most urgent event first.
"""

from enum import Enum, IntEnum
from typing import Final


class FlightMode(IntEnum):
    """What the vehicle is doing. protocol.messages.Status carries the number."""

    BOOT = 0
    """On the ground, motors off, waiting for healthy sensors."""
    READY = 1
    """On the ground, motors off, ready to be armed."""
    ARMED = 2
    """On the ground, motors idle."""
    TAKE_OFF = 3
    FLYING = 4
    """Follows the trajectory."""
    HOLD = 5
    """Holds its place on optical flow after the loss of the pose."""
    HOLD_LEVEL = 6
    """Velocity unknown: level attitude, slow descent by thrust alone."""
    LANDING = 7
    LANDED = 8
    """On the ground after a flight, motors off."""
    EMERGENCY = 9
    """Motors off because of a fault, until a disarm command."""
    TERMINATED = 10
    """Motors off by command, until the process ends."""


class Command(Enum):
    """Commands of a pilot, a ground station or the flight plan."""

    ARM = "arm"
    DISARM = "disarm"
    TAKE_OFF = "take off"
    LAND = "land"
    TERMINATE = "terminate"


class Event(Enum):
    """Everything that can change the mode; the value is its text in the log."""

    TERMINATE = "flight terminated by command"
    IMU_SILENT_LANDED = "IMU silent on the floor"
    IMU_SILENT = "IMU silent"
    FAULT = "fault in the flight computation"
    TILTED = "tilt beyond the limit"
    VELOCITY_LOST = "no velocity aid"
    VELOCITY_BACK = "velocity aid back"
    POSITION_LOST = "position lost"
    POSITION_BACK = "position back"
    GYRO_STUCK = "gyroscope axis stuck"
    BATTERY_LOW = "battery low"
    BATTERY_SILENT = "battery silent"
    GROUND_SILENT = "ground station silent"
    OUT_OF_BOUNDS = "outside the fence"
    TIME_UP = "time up"
    TOUCHED_DOWN = "touched down"
    AT_HEIGHT = "take-off height reached"
    ARM = "armed by command"
    DISARM = "disarmed by command"
    TAKE_OFF = "take-off by command"
    LAND = "landing by command"
    HEALTHY = "sensors healthy"
    UNHEALTHY = "sensors not healthy"


M, E = FlightMode, Event
Row = tuple[tuple[Event, FlightMode], ...]

_MOTORS_OFF: Final[Row] = (
    (E.TERMINATE, M.TERMINATED),
    (E.IMU_SILENT, M.EMERGENCY),
    (E.FAULT, M.EMERGENCY),
    (E.TILTED, M.EMERGENCY),
)
_MOTORS_OFF_DESCENDING: Final[Row] = (_MOTORS_OFF[0], (E.IMU_SILENT_LANDED, M.LANDED), *_MOTORS_OFF[1:])
_COME_DOWN: Final[Row] = (
    (E.VELOCITY_LOST, M.HOLD_LEVEL),
    (E.GYRO_STUCK, M.LANDING),
    (E.LAND, M.LANDING),
    (E.BATTERY_LOW, M.LANDING),
    (E.BATTERY_SILENT, M.LANDING),
    (E.GROUND_SILENT, M.LANDING),
    (E.OUT_OF_BOUNDS, M.LANDING),
)

TRANSITIONS: Final[dict[FlightMode, Row]] = {
    M.BOOT: ((E.TERMINATE, M.TERMINATED), (E.HEALTHY, M.READY)),
    M.READY: ((E.TERMINATE, M.TERMINATED), (E.UNHEALTHY, M.BOOT), (E.ARM, M.ARMED)),
    M.ARMED: (
        *_MOTORS_OFF,
        (E.DISARM, M.READY),
        (E.LAND, M.READY),
        (E.UNHEALTHY, M.BOOT),
        (E.TAKE_OFF, M.TAKE_OFF),
        (E.TIME_UP, M.READY),
    ),
    M.TAKE_OFF: (*_MOTORS_OFF, *_COME_DOWN, (E.TIME_UP, M.LANDING), (E.AT_HEIGHT, M.FLYING)),
    M.FLYING: (*_MOTORS_OFF, *_COME_DOWN, (E.POSITION_LOST, M.HOLD)),
    M.HOLD: (*_MOTORS_OFF, *_COME_DOWN, (E.POSITION_BACK, M.FLYING), (E.TIME_UP, M.LANDING)),
    M.HOLD_LEVEL: (
        *_MOTORS_OFF_DESCENDING,
        (E.TOUCHED_DOWN, M.LANDED),
        (E.VELOCITY_BACK, M.LANDING),
        (E.TIME_UP, M.LANDED),
    ),
    M.LANDING: (
        *_MOTORS_OFF_DESCENDING,
        (E.TOUCHED_DOWN, M.LANDED),
        (E.VELOCITY_LOST, M.HOLD_LEVEL),
        (E.TIME_UP, M.HOLD_LEVEL),
    ),
    M.LANDED: ((E.TERMINATE, M.TERMINATED), (E.DISARM, M.BOOT), (E.TIME_UP, M.BOOT)),
    M.EMERGENCY: ((E.TERMINATE, M.TERMINATED), (E.DISARM, M.BOOT)),
    M.TERMINATED: (),
}

SPINNING: Final = frozenset({M.ARMED, M.TAKE_OFF, M.FLYING, M.HOLD, M.HOLD_LEVEL, M.LANDING})
"""Modes in which the motors may turn."""
RESTING: Final = frozenset({M.BOOT, M.READY})
"""Modes of a vehicle that stands with its motors off. After a landing it has come to rest before them."""
AIRBORNE: Final = frozenset({M.TAKE_OFF, M.FLYING, M.HOLD, M.HOLD_LEVEL, M.LANDING})

COMMAND_EVENTS: Final = {command: Event[command.name] for command in Command}
