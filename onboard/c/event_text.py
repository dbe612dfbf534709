"""Makes the texts of the C core's events, which carry numbers only: the same texts as the numpy core's."""

from math import degrees
from typing import Any, Final

from onboard.c.constants_table import ENUMERATIONS
from onboard.control.guard import LAWS, Level
from onboard.estimation.calibration import CALIBRATING, MOVED
from onboard.estimation.imu_conditioning import AXES
from onboard.links.offboard import PEER_RESTARTED
from protocol.endpoint import mismatch_text
from protocol.messages import REFUSALS
from protocol.signals import CHANNELS

_MODES, _EVENTS, _COMMANDS = (list(ENUMERATIONS[prefix]) for prefix in ("MODE", "EVENT", "COMMAND"))
_REFUSALS: Final = (
    "",
    "",
    "IMU silent or attitude not found",
    "no fresh pose",
    "not level",
    "battery at {value:.2f} V",
    "battery at {value:.4g} V: not one cell, or not in volts",
    "battery at {value:.0%}",
    "no battery report",
    "battery report too old",
    "no ground station",
    "{value:.1f} m from the origin, the fence is at {limit:g} m",
    "",
    "",
    "not running yet",
)
"""Of each ArmingReason of flight/supervisor.h; those with "" have a text of another owner."""
_PREFLIGHT, _CALIBRATION, _OTHER_MODE = 1, 12, 13


def refusal_text(refusal: Any, preflight: dict[int, str], calibration: dict[int, str]) -> str:
    """The text of an ArmingRefusal; "" if arming is allowed.

    preflight, calibration: texts of the numbers that the caller has given the supervisor.
    """
    if refusal.reason == _PREFLIGHT:
        return preflight[refusal.number]
    if refusal.reason == _CALIBRATION:
        return calibration[refusal.number]
    if refusal.reason == _OTHER_MODE:
        return f"not in mode {_MODES[refusal.number].name}"
    return _REFUSALS[refusal.reason].format(value=refusal.value, limit=refusal.limit)


def supervisor_text(event: Any, preflight: dict[int, str], calibration: dict[int, str]) -> str:
    """The text of a SupervisorEvent."""
    refusal = refusal_text(event.refusal, preflight, calibration)
    match event.kind:
        case 0:
            return f"refused to {_COMMANDS[event.command].value}: {refusal}"
        case 1:
            why = f": {refusal}" if refusal else ""
            modes = f"{_MODES[getattr(event, 'from')].name} -> {_MODES[event.to].name}"
            return f"{modes}: {_EVENTS[event.event].value}{why}"
        case 2:
            return "offboard silent"
        case 3:
            return "offboard connected"
        case _:
            return f"not ready to arm: {refusal}"


_AIDS: Final = ("flow", "range", "pressure", "pose", "pose")
"""Of each Aid of estimation/events.h."""


def calibration_text(calibration: Any) -> str:
    """Why a BenchCalibration forbids arming; "" if it does not."""
    if calibration.refusal == 3:
        return _bias_text(calibration.biased_axis, calibration.bias, calibration.bias_max)
    return ("", CALIBRATING, MOVED)[calibration.refusal]


def _bias_text(axis: int, bias: float, limit: float) -> str:
    return f"gyroscope {AXES[axis]} has a bias of {bias:+.2f} rad/s, the limit is {limit:g}"


def estimator_text(event: Any) -> str:
    """The text of an EstimatorEvent."""
    number, values = event.number, list(event.values)
    match event.kind:
        case 0:
            return f"position estimate jumped {values[0]:.2f} m ({_AIDS[number]})"
        case 1:
            return f"{_AIDS[number]} refused for long: uncertainty increased, it will be accepted"
        case 2:
            return f"IMU gap of {values[0] * 1e3:.0f} ms"
        case 3:
            return f"attitude found: roll {degrees(values[0]):.1f}, pitch {degrees(values[1]):.1f} deg"
        case 4:
            return f"gyroscope {AXES[number]} stuck: its rate comes from the motors from now on"
        case 5:
            x, y, z, along_gravity, seconds = values
            bias = f"gyroscope bias ({x:+.4f}, {y:+.4f}, {z:+.4f}) rad/s"
            along = f"accelerometer {along_gravity:+.3f} m/s^2 along gravity"
            return f"IMU calibrated: {bias}, {along}, {seconds:.1f} s at rest"
        case 6:
            sensor, unit = ("accelerometer", "m/s^2") if number < 3 else ("gyroscope", "rad/s")
            return f"{MOVED}: {sensor} {AXES[number % 3]} off by {values[0]:+.2g} {unit}"
        case 7:
            return _bias_text(number, values[0], values[1])
        case _:
            return f"the poses drift, by {values[0]:.2f} m against flow or range: refused"


def link_text(event: Any) -> str:
    """The text of a LinkEvent."""
    return PEER_RESTARTED if event.kind == 0 else mismatch_text(bytes(event.peer_layout), bytes(event.layout))


def version_text(outcome: Any) -> str:
    """The text of what became of the version in a VersionOutcome that had one."""
    if outcome.refusal:
        return f"features {outcome.version} refused: {REFUSALS[outcome.refusal]}"
    return f"features {outcome.version} in use, parent {outcome.parent}, {outcome.samples} samples"


_FALL_REASONS: Final = (
    "misfit of {}", "misfit over its trial of {}", "model error of {}", "steep or high ahead in {}",
    "misfit of the version before",
)  # fmt: skip
"""Of each FallReason of control/guard.h."""


def fall_text(fall: Any) -> str:
    """The text of a Fall."""
    reason = f"guard: {_FALL_REASONS[fall.reason].format(CHANNELS[fall.channel])}"
    match fall.kind:
        case 0:
            return f"{reason}: version {fall.refused} taken back, version {fall.flying} flies"
        case 1:
            return f"{reason}: {LAWS[Level(fall.level)]} flies"
        case _:
            return f"guard: version {fall.flying} flies after its audition"
