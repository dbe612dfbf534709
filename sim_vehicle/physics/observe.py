"""What an agent sees of a batch, by name, and what it is rewarded for. Compiled."""

from math import exp, sqrt
from typing import Final

import numpy as np
from numpy.typing import NDArray

import sim_vehicle.physics.layout as at
from protocol.conventions import Array
from sim_vehicle.physics.compiled import compiled
from sim_vehicle.physics.dynamics import rotation, to_body

OBSERVATIONS: Final[dict[str, tuple[int, int, str]]] = {
    "position_error": (0, 3, "m, NED, target minus position"),
    "velocity_error": (3, 3, "m/s, NED, target minus velocity"),
    "position": (6, 3, "m, NED"),
    "velocity": (9, 3, "m/s, NED"),
    "rotation": (12, 9, "rotation matrix from body FRD to NED, row by row"),
    "quaternion": (21, 4, "wxyz, body FRD to NED"),
    "rates": (25, 3, "rad/s, body FRD"),
    "body_velocity": (28, 3, "m/s, body FRD"),
    "motor_thrust": (31, 4, "share of the nominal full thrust, PX4 motor order"),
    "voltage": (35, 1, "V"),
    "last_action": (36, 4, "action of the step before; the fourth is 0 where an action has three parts"),
    "target_acceleration": (40, 3, "m/s^2, NED"),
    "air_velocity": (43, 3, "m/s, NED, of the air at the vehicle: no real vehicle measures it"),
}
"""First column, width and unit of each observation."""
COLUMNS: Final = 46
LAST_ACTION: Final = 36

REWARD_LENGTH_M: Final = 0.3
"""Error at which the reward has fallen to 1/e."""
REWARD_OF_RATES: Final = 0.02
"""1/(rad/s)."""
REWARD_OF_CHANGE: Final = 0.05
"""Per squared change of the action."""


@compiled
def observe_all(
    states: Array,
    path: Array,
    steps: NDArray[np.int64],
    actions: Array,
    full_thrust_n: float,
    distance_max_m: float,
    table: Array,
    rewards: Array,
    lost: NDArray[np.bool_],
) -> None:
    """Write the observations [vehicles, COLUMNS], the rewards [vehicles], and who is too far from the target.

    reward = exp(-|e| / 0.3 m) - 0.02 |omega| - 0.05 |a - a_before|^2

    Parameters
    ----------
    path: [n, 9], target of each control step. steps: [vehicles], number of each one's step.
    actions: [vehicles, 3 or 4]; those before are in the table.
    """
    for k in range(states.shape[0]):
        x, row = states[k], table[k]
        target = path[min(steps[k], path.shape[0] - 1)]
        R = rotation(x[6], x[7], x[8], x[9])
        for i in range(6):
            row[i] = target[i] - x[i]
            row[6 + i] = x[i]
        for i in range(9):
            row[12 + i] = R[i]
        for i in range(4):
            row[21 + i] = x[at.QUATERNION + i]
            row[31 + i] = x[at.THRUST + i] / full_thrust_n
        body = to_body(R, x[3], x[4], x[5])
        for i in range(3):
            row[25 + i] = x[at.RATES + i]
            row[28 + i] = body[i]
            row[40 + i] = target[6 + i]
            row[43 + i] = x[at.WIND + i]
        row[35] = x[at.VOLTAGE]
        change = 0.0
        for i in range(actions.shape[1]):
            change += (actions[k, i] - row[LAST_ACTION + i]) ** 2
            row[LAST_ACTION + i] = actions[k, i]
        distance = sqrt(row[0] * row[0] + row[1] * row[1] + row[2] * row[2])
        turn = sqrt(x[10] * x[10] + x[11] * x[11] + x[12] * x[12])
        rewards[k] = exp(-distance / REWARD_LENGTH_M) - REWARD_OF_RATES * turn - REWARD_OF_CHANGE * change
        lost[k] = not distance < distance_max_m
