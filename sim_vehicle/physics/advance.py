"""Several sub-steps in one call: disturbances, motors, battery, rigid body, sums for sensors and truth. Compiled."""

from math import acos, cos, sin

import sim_vehicle.physics.layout as at
from protocol.conventions import Array
from protocol.geometry import Rotation
from sim_vehicle.physics.compiled import compiled
from sim_vehicle.physics.disturb import disturb
from sim_vehicle.physics.dynamics import (
    FLOOR_REACH,
    cross,
    lowest_point,
    rotation,
    runge_kutta,
    to_body,
    to_world,
)
from sim_vehicle.physics.motors import drain_battery, lag_motors

CLEARANCE = 0.01
"""m above the floor from which the vehicle is airborne. It touches the floor at 0, so the flag does not chatter."""
WORK_ROWS = 10
"""Rows of 13 of the work array: 5 for Runge-Kutta, 3 thrusts, 1 effect of the disturbances, 1 nominal thrust."""


@compiled
def nominal_torque(state: Array, P: Array) -> tuple[float, float, float, float]:
    """Collective thrust, N, and torque, N m body, that the nominal model gives for the present commands."""
    T1, T2, T3, T4 = (
        state[at.NOMINAL_THRUST],
        state[at.NOMINAL_THRUST + 1],
        state[at.NOMINAL_THRUST + 2],
        state[at.NOMINAL_THRUST + 3],
    )
    x, y, k = P[at.NOMINAL_ARM_X], P[at.NOMINAL_ARM_Y], P[at.NOMINAL_TORQUE_RATIO]
    return (T1 + T2 + T3 + T4, y * (T2 + T3 - T1 - T4), x * (T1 + T3 - T2 - T4), k * (T1 + T2 - T3 - T4))


@compiled
def account(state: Array, before: Array, middle: Rotation, nominal: Array, P: Array, sums: Array) -> None:
    """Add one sub-step to the sums of the IMU and of the truth.

    before: [13] state at the start. middle: rotation in the middle. nominal: [4] collective thrust and torque.
    """
    h = P[at.STEP]
    gained = (state[3] - before[3], state[4] - before[4], state[5] - before[5])
    for i in range(3):
        state[at.ACCELERATION + i] = gained[i] / h
    if P[at.SUM_SENSORS] <= 0.0:
        return
    for i in range(3):
        sums[at.TRUTH_VELOCITY + i] += gained[i]
        sums[at.TRUTH_RATES + i] += state[at.RATES + i] - before[at.RATES + i]
    specific_force = to_body(middle, gained[0], gained[1], gained[2] - P[at.GRAVITY] * h)
    sums[at.IMU_TIME] += h
    for i in range(3):
        sums[at.IMU_FORCE + i] += specific_force[i]
    sums[at.TRUTH_TIME] += h
    lift = to_world(middle, 0.0, 0.0, -nominal[0] * h)
    m = P[at.NOMINAL_MASS]
    sums[at.TRUTH_FORCE] += m * gained[0] - lift[0]
    sums[at.TRUTH_FORCE + 1] += m * gained[1] - lift[1]
    sums[at.TRUTH_FORCE + 2] += m * (gained[2] - P[at.GRAVITY] * h) - lift[2]
    w = (
        0.5 * (state[10] + before[10]),
        0.5 * (state[11] + before[11]),
        0.5 * (state[12] + before[12]),
    )
    J = (P[at.NOMINAL_INERTIA], P[at.NOMINAL_INERTIA + 1], P[at.NOMINAL_INERTIA + 2])
    gyro = cross(w, (J[0] * w[0], J[1] * w[1], J[2] * w[2]))
    for i in range(3):
        turned = J[i] * (state[at.RATES + i] - before[at.RATES + i])
        sums[at.TRUTH_TORQUE + i] += turned + h * (gyro[i] - nominal[1 + i])


@compiled
def account_flow(state: Array, R: Rotation, P: Array, sums: Array) -> None:
    """Add one sub-step to the integrals of the optical flow, in PX4's signs (sim_vehicle/sensors/flow.py)."""
    h = P[at.STEP]
    v = to_body(R, state[3], state[4], state[5])
    distance = max(0.02, -state[at.POSITION + 2]) / max(0.1, R[8])
    sums[at.FLOW_TIME] += h
    sums[at.FLOW_ANGLE] += h * (state[at.RATES] - v[1] / distance)
    sums[at.FLOW_ANGLE + 1] += h * (state[at.RATES + 1] + v[0] / distance)
    for i in range(3):
        sums[at.FLOW_GYRO + i] += h * state[at.RATES + i]


@compiled
def account_tones(state: Array, P: Array, sums: Array) -> None:
    """Add one sub-step to the rotors' tones that the IMU feels (sim_vehicle/sensors/vibration.py)."""
    if P[at.SUM_TONES] <= 0.0:
        return
    for i in range(4):
        c, s = cos(state[at.ROTOR_PHASE + i]), sin(state[at.ROTOR_PHASE + i])
        thrust, first = state[at.THRUST + i], at.IMU_TONES + 4 * i
        sums[first] += thrust * c
        sums[first + 1] += thrust * s
        sums[first + 2] += thrust * (c * c - s * s)
        sums[first + 3] += thrust * 2.0 * s * c


@compiled
def watch_floor(state: Array, sinking: float, R: Rotation, P: Array, sums: Array) -> None:
    """Update the airborne flag, and speed and tilt of touch-downs. sinking: m/s at the start of the sub-step."""
    lowest = lowest_point(state, R, P) if state[at.POSITION + 2] > -FLOOR_REACH else -1.0
    if lowest < -CLEARANCE:
        state[at.AIRBORNE] = 1.0
    elif lowest >= 0.0 and state[at.AIRBORNE] > 0.0:
        state[at.AIRBORNE] = 0.0
        sums[at.TOUCH_SPEED] = max(sums[at.TOUCH_SPEED], sinking)
        sums[at.TOUCH_TILT] = max(sums[at.TOUCH_TILT], acos(min(1.0, max(-1.0, R[8]))))


@compiled
def advance(
    state: Array,
    commands: Array,
    P: Array,
    rows: Array,
    memories: Array,
    noise: Array,
    sums: Array,
    work: Array,
    time_s: float,
    count: int,
) -> None:
    """Advance one vehicle by `count` sub-steps of P[STEP] seconds from flight time `time_s`, in place.

    Parameters
    ----------
    state: [STATE_SIZE]. commands: [4] fractions, zero is off. P: [PARAMETERS_SIZE].
    rows, memories: [k, .], see World. noise: [>= count, k, NOISE_PER_ROW] unit normal draws.
    sums: [SUMS_SIZE]. work: [WORK_ROWS, 13] scratch memory.
    """
    thrust, effect, nominal = work[5:8, :4], work[8, : at.EFFECT_SIZE], work[9, :4]
    wind, before, load = state[at.WIND : at.WIND + 3], work[4], effect[at.FORCE : at.TORQUE + 3]
    for step in range(count):
        now = time_s + step * P[at.STEP]
        disturb(state, rows, memories, now, P, noise[step], effect)
        lag_motors(state, commands, P, thrust)
        sums[at.CURRENT] = drain_battery(state, effect[at.VOLTAGE_DROP], P)
        wanted = nominal_torque(state, P)
        for i in range(4):
            nominal[i] = wanted[i]
        p0, p1, p2 = state[3], state[4], state[5]
        r0, r1, r2 = state[10], state[11], state[12]
        q0, q1, q2, q3 = state[6], state[7], state[8], state[9]
        runge_kutta(state, thrust, wind, load, P, work)
        before[3], before[4], before[5] = p0, p1, p2
        before[10], before[11], before[12] = r0, r1, r2
        middle = rotation(q0 + state[6], q1 + state[7], q2 + state[8], q3 + state[9])
        account(state, before, middle, nominal, P, sums)
        if P[at.SUM_SENSORS] > 0.0:
            account_flow(state, middle, P, sums)
            account_tones(state, P, sums)
        watch_floor(state, p2, middle, P, sums)


@compiled
def write_truth(state: Array, sums: Array, P: Array, truth: Array) -> None:
    """Write the truth record (see records.TRUTH) into truth[34] and zero its sums."""
    scale = 1.0 / max(sums[at.TRUTH_TIME], 1.0e-9)
    for i in range(at.RIGID):
        truth[i] = state[i]
    for i in range(3):
        truth[13 + i] = sums[at.TRUTH_VELOCITY + i] * scale
        truth[16 + i] = sums[at.TRUTH_RATES + i] * scale
        truth[23 + i] = state[at.WIND + i]
        truth[26 + i] = sums[at.TRUTH_FORCE + i] * scale
        truth[29 + i] = sums[at.TRUTH_TORQUE + i] * scale
    for i in range(4):
        truth[19 + i] = state[at.THRUST + i] * P[at.THRUST_FACTOR + i]
    truth[32] = state[at.VOLTAGE]
    truth[33] = state[at.AIRBORNE]
    sums[at.TRUTH_TIME : at.TRUTH_RATES + 3] = 0.0
