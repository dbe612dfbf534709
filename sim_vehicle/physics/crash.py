"""When the simulated vehicle crashes."""

from math import acos, degrees, radians
from typing import Final

import numpy as np

import sim_vehicle.physics.layout as at
from protocol.conventions import Array
from sim_vehicle.config import SimVehicleConfig
from sim_vehicle.physics.compiled import compiled

TOUCH_SPEED_MAX_M_S: Final = 1.0
"""Of sinking, at a touch-down."""
TOUCH_TILT_MAX_RAD: Final = radians(35.0)
"""At a touch-down."""
TILT_MAX_RAD: Final = radians(80.0)
"""Anywhere."""

NO_CRASH, HARD_TOUCH, TILTED_TOUCH, TILTED, OUTSIDE = 0, 1, 2, 3, 4
"""Results of `check_crash`."""


def crash_limits(config: SimVehicleConfig) -> Array:
    """[4] as `check_crash` reads them."""
    return np.array([TOUCH_SPEED_MAX_M_S, TOUCH_TILT_MAX_RAD, TILT_MAX_RAD, config.box_m])


@compiled
def tilt_of(state: Array) -> float:
    """Angle, rad, between the body's down axis and the world's."""
    x, y = state[at.QUATERNION + 1], state[at.QUATERNION + 2]
    return acos(min(1.0, max(-1.0, 1.0 - 2.0 * (x * x + y * y))))


@compiled
def check_crash(state: Array, sums: Array, limits: Array) -> int:
    """Whether the vehicle has crashed, and how. Zeroes the sums of the touch-downs if not.

    limits: [4] touch-down speed m/s, tilt at touch-down rad, tilt rad, distance from the origin m.
    """
    if sums[at.TOUCH_SPEED] > limits[0]:
        return HARD_TOUCH
    if sums[at.TOUCH_TILT] > limits[1]:
        return TILTED_TOUCH
    if tilt_of(state) > limits[2]:
        return TILTED
    if not state[0] ** 2 + state[1] ** 2 + state[2] ** 2 < limits[3] ** 2:
        return OUTSIDE
    sums[at.TOUCH_SPEED] = 0.0
    sums[at.TOUCH_TILT] = 0.0
    return NO_CRASH


def crash_reason(crash: int, state: Array, sums: Array) -> str:
    """Why the vehicle has crashed; empty if it has not. crash: what `check_crash` gave for `state` and `sums`."""
    if crash == NO_CRASH:
        return ""
    if crash == HARD_TOUCH:
        return f"hit the floor at {sums[at.TOUCH_SPEED]:.1f} m/s"
    if crash == TILTED_TOUCH:
        return f"touched the floor tilted by {degrees(sums[at.TOUCH_TILT]):.0f} deg"
    if crash == TILTED:
        return f"tilted by {degrees(tilt_of(state)):.0f} deg"
    return f"left the room, {np.linalg.norm(state[: at.VELOCITY]):.1f} m from the origin"
