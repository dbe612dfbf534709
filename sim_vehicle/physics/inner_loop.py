"""From an agent's action to motor commands, for a batch: an inner loop that knows the true state. Compiled.

The agents of async_dmrac/environments act by it. It has the vehicle's nominal mass, inertia and motors, the position
gains and the rate gain K_2 of a controller of configs/controllers, K_1 = K_2^2 / 4 (critically damped), and no law:
what it does not know is left to the agent.

    acceleration:  u = K_1 (p_d - p) + K_2 (v_d - v) + a_d + action       residual mode; else u = action
    attitude:      force = g e_3 - u per mass; the body's down axis turns to it, yaw to 0
    rates:         alpha = K_1 e_R - K_2 omega, or K_2 (omega_d - omega)
    torque:        tau = J alpha + omega x J omega
    motors:        command = T + (wanted - T) max(lag / response, 1), T the present thrust, as onboard leads them
"""

from math import sqrt
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

import sim_vehicle.physics.layout as at
from protocol.conventions import Array
from sim_vehicle.physics.compiled import compiled
from sim_vehicle.physics.dynamics import rotation

Integers: TypeAlias = NDArray[np.int64]

MOTORS: Final = 0  # [4] fractions of full thrust, -1: none, 1: full
RATES: Final = 1  # [4] collective thrust, -1: none, 1: full, and body rates
ACCELERATION: Final = 2  # [3] NED, as a share of ACCELERATION_MAX
RESIDUAL: Final = 3  # [3] NED, as a share of RESIDUAL_MAX, added to the position loop's demand

# --- settings of the loop -----------------------------------------------------------------------------------------
MASS: Final = 0  # kg
INERTIA: Final = 1  # kg m^2, [3]
ARM_X: Final = 4  # m
ARM_Y: Final = 5  # m
TORQUE_RATIO: Final = 6  # m
MAX_THRUST: Final = 7  # N, per motor
MIN_SHARE: Final = 8  # of MAX_THRUST
LEAD_UP: Final = 9  # max(lag / response, 1)
LEAD_DOWN: Final = 10
GRAVITY: Final = 11  # m/s^2
POSITION_K1: Final = 12  # 1/s^2, [3]
POSITION_K2: Final = 15  # 1/s, [3]
ATTITUDE_K1: Final = 18  # 1/s^2, [3]
ATTITUDE_K2: Final = 21  # 1/s, [3]
RATES_MAX: Final = 24  # rad/s
ACCELERATION_MAX: Final = 25  # m/s^2
RESIDUAL_MAX: Final = 26  # m/s^2
SETTINGS_SIZE: Final = 27

# --- one row of the path: target of a control step ---------------------------------------------------------------
TARGET_POSITION: Final = 0  # m, NED
TARGET_VELOCITY: Final = 3  # m/s
TARGET_ACCELERATION: Final = 6  # m/s^2
TARGET_SIZE: Final = 9


@compiled
def mix(thrust_n: float, torque: tuple[float, float, float], S: Array, wanted: Array) -> None:
    """Write the motor thrusts, N: the same as onboard.control.mixer.Mixer, to rounding."""
    high = S[MAX_THRUST]
    low = S[MIN_SHARE] * high
    roll = 0.25 * torque[0] / S[ARM_Y]
    pitch = 0.25 * torque[1] / S[ARM_X]
    yaw = 0.25 * torque[2] / S[TORQUE_RATIO]
    spread = 2.0 * (abs(roll) + abs(pitch))
    if spread > high - low:
        roll *= (high - low) / spread
        pitch *= (high - low) / spread
    first, second = pitch - roll, pitch + roll
    raised, lowered = abs(first), abs(second)
    if yaw < 0.0:
        raised, lowered = lowered, raised
    turn, middle = abs(yaw), 0.5 * (raised + lowered)
    lowest = max(low + lowered, low + raised - turn, low + middle)
    highest = min(high - raised, high - lowered + turn, high - middle)
    base = min(max(0.25 * thrust_n, lowest), highest)
    turn = max(min(turn, high - base - raised, base - lowered - low), 0.0)
    if yaw < 0.0:
        turn = -turn
    wanted[0], wanted[1] = base + first + turn, base - first + turn
    wanted[2], wanted[3] = base + second - turn, base - second - turn


@compiled
def torque_for(alpha: tuple[float, float, float], state: Array, S: Array) -> tuple[float, float, float]:
    """tau = J alpha + omega x J omega, N m."""
    p, q, r = state[at.RATES], state[at.RATES + 1], state[at.RATES + 2]
    Jx, Jy, Jz = S[INERTIA], S[INERTIA + 1], S[INERTIA + 2]
    return Jx * alpha[0] + (Jz - Jy) * q * r, Jy * alpha[1] + (Jx - Jz) * p * r, Jz * alpha[2] + (Jy - Jx) * p * q


@compiled
def fly_acceleration(u: tuple[float, float, float], state: Array, S: Array, wanted: Array) -> None:
    """Write the motor thrusts, N, that accelerate the vehicle by u, m/s^2 NED, with yaw 0."""
    R = rotation(state[6], state[7], state[8], state[9])
    fx, fy, fz = -u[0], -u[1], max(S[GRAVITY] - u[2], 0.2 * S[GRAVITY])
    size = sqrt(fx * fx + fy * fy + fz * fz)
    zx, zy, zz = fx / size, fy / size, fz / size  # the body's down axis, as demanded
    # y_d = z_d x north, normalised; x_d = y_d x z_d
    side = sqrt(zz * zz + zy * zy)
    yy, yz = zz / side, -zy / side
    xx, xy, xz = yy * zz - yz * zy, yz * zx, -yy * zx
    # e_R: the vector part of R' R_d
    m21 = R[5] * yy + R[8] * yz  # y_d has no north part
    m12 = R[1] * zx + R[4] * zy + R[7] * zz
    m02 = R[0] * zx + R[3] * zy + R[6] * zz
    m20 = R[2] * xx + R[5] * xy + R[8] * xz
    m10 = R[1] * xx + R[4] * xy + R[7] * xz
    m01 = R[3] * yy + R[6] * yz
    e = (0.5 * (m21 - m12), 0.5 * (m02 - m20), 0.5 * (m10 - m01))
    alpha = (
        S[ATTITUDE_K1] * e[0] - S[ATTITUDE_K2] * state[at.RATES],
        S[ATTITUDE_K1 + 1] * e[1] - S[ATTITUDE_K2 + 1] * state[at.RATES + 1],
        S[ATTITUDE_K1 + 2] * e[2] - S[ATTITUDE_K2 + 2] * state[at.RATES + 2],
    )
    along = fx * R[2] + fy * R[5] + fz * R[8]
    mix(max(S[MASS] * along, 0.0), torque_for(alpha, state, S), S, wanted)


@compiled
def demand(mode: int, action: Array, state: Array, target: Array, S: Array) -> tuple[float, float, float]:
    """u, m/s^2 NED, of the modes ACCELERATION and RESIDUAL."""
    a = S[ACCELERATION_MAX] if mode == ACCELERATION else S[RESIDUAL_MAX]
    u0, u1, u2 = a * action[0], a * action[1], a * action[2]
    if mode == RESIDUAL:
        u0 += target[6] + S[POSITION_K1] * (target[0] - state[0]) + S[POSITION_K2] * (target[3] - state[3])
        u1 += target[7] + S[POSITION_K1 + 1] * (target[1] - state[1]) + S[POSITION_K2 + 1] * (target[4] - state[4])
        u2 += target[8] + S[POSITION_K1 + 2] * (target[2] - state[2]) + S[POSITION_K2 + 2] * (target[5] - state[5])
    return u0, u1, u2


@compiled
def command_all(
    mode: int, actions: Array, states: Array, path: Array, steps: Integers, S: Array, work: Array, commands: Array
) -> None:
    """Write the motor commands [vehicles, 4], shares of full thrust, of each vehicle's action.

    Parameters
    ----------
    actions: [vehicles, 4] or, with ACCELERATION and RESIDUAL, [vehicles, 3]; clipped to -1 to 1.
    path: [n, TARGET_SIZE], target of each control step. steps: [vehicles], number of each one's step.
    S: [SETTINGS_SIZE]. work: [4] scratch memory.
    """
    high, low = S[MAX_THRUST], S[MIN_SHARE]
    for k in range(states.shape[0]):
        action, state = actions[k], states[k]
        for i in range(action.shape[0]):
            action[i] = min(max(action[i], -1.0), 1.0)
        if mode == MOTORS:
            for i in range(4):
                commands[k, i] = max(0.5 * (action[i] + 1.0), low)
            continue
        if mode == RATES:
            alpha = (
                S[ATTITUDE_K2] * (S[RATES_MAX] * action[1] - state[at.RATES]),
                S[ATTITUDE_K2 + 1] * (S[RATES_MAX] * action[2] - state[at.RATES + 1]),
                S[ATTITUDE_K2 + 2] * (S[RATES_MAX] * action[3] - state[at.RATES + 2]),
            )
            mix(2.0 * (action[0] + 1.0) * high, torque_for(alpha, state, S), S, work)
        else:
            target = path[min(steps[k], path.shape[0] - 1)]
            fly_acceleration(demand(mode, action, state, target, S), state, S, work)
        for i in range(4):
            present = state[at.THRUST + i]
            lead = S[LEAD_UP] if work[i] > present else S[LEAD_DOWN]
            commands[k, i] = min(max((present + (work[i] - present) * lead) / high, low), 1.0)
