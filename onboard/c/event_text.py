"""Makes the texts of the C core's events, which carry numbers only: the same texts as the numpy core's."""

from typing import Any, Final

from onboard.c.constants_table import ENUMERATIONS

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
