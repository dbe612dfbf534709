"""A sub-step in another simulator's physics: the prediction of its middle, and the sums at its end. Compiled."""

import sim_vehicle.physics.layout as at
from protocol.conventions import Array
from sim_vehicle.physics.advance import account, account_flow, account_tones, nominal_torque, watch_floor
from sim_vehicle.physics.compiled import compiled
from sim_vehicle.physics.dynamics import rotation

THRUST_ROWS, BEFORE, MIDDLE, EFFECT, NOMINAL = 3, 3, 4, 5, 6
"""Rows of the work array: thrusts in the first three, rigid body at the start of the sub-step and predicted for its
middle, effect of the disturbances, thrust and torque of the nominal model."""


@compiled
def predict_middle(state: Array, P: Array, middle: Array) -> None:
    """Write the rigid body in the middle of the sub-step into middle[13], from its velocity, rates and acceleration."""
    h = 0.5 * P[at.STEP]
    for i in range(3):
        middle[at.POSITION + i] = state[at.POSITION + i] + h * state[at.VELOCITY + i]
        middle[at.VELOCITY + i] = state[at.VELOCITY + i] + h * state[at.ACCELERATION + i]
        middle[at.RATES + i] = state[at.RATES + i]
    w, x, y, z = state[6], state[7], state[8], state[9]
    p, q, r = 0.5 * h * state[10], 0.5 * h * state[11], 0.5 * h * state[12]
    middle[6], middle[7] = w - x * p - y * q - z * r, x + w * p + y * r - z * q
    middle[8], middle[9] = y + w * q + z * p - x * r, z + w * r + x * q - y * p


@compiled
def note_start(state: Array, P: Array, work: Array) -> None:
    """Write the rows NOMINAL, of the nominal thrusts as they are now, and BEFORE, of the rigid body as it is now."""
    nominal = nominal_torque(state, P)
    for i in range(4):
        work[NOMINAL, i] = nominal[i]
    for i in range(at.RIGID):
        work[BEFORE, i] = state[i]


@compiled
def account_substep(state: Array, P: Array, sums: Array, work: Array) -> None:
    """Add the sub-step that ends at `state` to the sums for sensors and truth. work: its rows BEFORE and NOMINAL."""
    before = work[BEFORE]
    middle = rotation(before[6] + state[6], before[7] + state[7], before[8] + state[8], before[9] + state[9])
    account(state, before, middle, work[NOMINAL, :4], P, sums)
    account_flow(state, middle, P, sums)
    account_tones(state, P, sums)
    watch_floor(state, before[at.VELOCITY + 2], middle, P, sums)
