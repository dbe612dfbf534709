"""How the thrust of a path turns: the rate and the angular acceleration that flying the path needs.

Theory of operation (differential flatness; Mellinger and Kumar 2011). The vehicle's down axis lies along f = g e_3 - a,
with a the acceleration of the path. With the derivatives f' and f'' in time,

    omega = f x f' / |f|^2,    alpha = f x f'' / |f|^2 - 2 (f . f') / |f|^2 omega.

Both are functions of the path alone: no feedback, and no noise. f' and f'' are central differences over STEP_S to
either side. So a path whose acceleration jumps asks for its turn within twice that time, not for an impulse.
"""

from typing import Final, NamedTuple

from onboard.control.demand_limits import FALL_MIN_M_S2
from protocol.conventions import GRAVITY
from protocol.geometry import ZERO, Vector3, cross

STEP_S: Final = 0.04
"""The relative error of the differences is (omega STEP_S)^2 / 12, 0.1 % for a figure-8 with a lap of 4 s."""


class PathTurn(NamedTuple):
    """World NED."""

    rate: Vector3 = ZERO
    """rad/s."""
    acceleration: Vector3 = ZERO
    """rad/s^2."""


def path_turn(before: Vector3, now: Vector3, after: Vector3) -> PathTurn:
    """The turn, from the path's acceleration [m/s^2, world NED] STEP_S before, at the present, and STEP_S after."""
    f = -now[0], -now[1], max(GRAVITY - now[2], FALL_MIN_M_S2)
    once, twice = 0.5 / STEP_S, 1.0 / (STEP_S * STEP_S)
    f_1 = once * (before[0] - after[0]), once * (before[1] - after[1]), once * (before[2] - after[2])
    x, y, z = (twice * ((b - a) - (c - b)) for a, b, c in zip(before, now, after, strict=True))
    square = f[0] * f[0] + f[1] * f[1] + f[2] * f[2]
    wx, wy, wz = (one / square for one in cross(f, f_1))
    ax, ay, az = (one / square for one in cross(f, (x, y, z)))
    stretch = 2.0 * (f[0] * f_1[0] + f[1] * f_1[1] + f[2] * f_1[2]) / square
    return PathTurn((wx, wy, wz), (ax - stretch * wx, ay - stretch * wy, az - stretch * wz))
