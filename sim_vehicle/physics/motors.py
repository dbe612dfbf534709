"""Motors and battery: from commands to thrust, rotor phase and terminal voltage, over one sub-step.

The thrust of a motor follows its command with a first-order lag, faster up than down. The lag is solved exactly over a
sub-step, so the motors add no integration error. Thrust per command grows with the square of the voltage.
"""

from math import pi, sqrt

import sim_vehicle.physics.layout as at
from protocol.conventions import Array
from sim_vehicle.physics.compiled import compiled, inlined

TWO_PI = 2.0 * pi
LEAST_THRUST = 1.0e-12
"""N; less becomes 0, because denormal numbers slow the processor down."""


@inlined
def turn_rotor(state: Array, i: int, speed: float, P: Array) -> None:
    """Advance the phase of rotor i. speed: rad/s, of a rotor that needs the usual speed for its thrust."""
    phase = state[at.ROTOR_PHASE + i] + speed * P[at.ROTOR_SPEED + i] * P[at.STEP]
    state[at.ROTOR_PHASE + i] = phase - TWO_PI * int(phase / TWO_PI)


@inlined
def lag_nominal(state: Array, i: int, command: float, P: Array) -> None:
    """Advance the thrust of motor i in the nominal model. command: fraction of full thrust."""
    nominal = state[at.NOMINAL_THRUST + i]
    wanted = command * P[at.NOMINAL_MAX_THRUST]
    rest = at.NOMINAL_KEEP if wanted > nominal else at.NOMINAL_KEEP + 1
    after = wanted + (nominal - wanted) * P[rest]
    state[at.NOMINAL_THRUST + i] = after if after >= LEAST_THRUST else 0.0


@compiled
def lag_motors(state: Array, commands: Array, P: Array, thrust: Array) -> None:
    """Advance the motors by one sub-step.

    Parameters
    ----------
    state: [STATE_SIZE], changed in place: thrusts, nominal thrusts, rotor phases.
    commands: [4] fractions of full thrust, 0..1, PX4 order; zero is off.
    P: [PARAMETERS_SIZE].
    thrust: [3, 4] out: N, thrust of an undamaged rotor at the start, the middle and the end of the sub-step.
    """
    ratio = state[at.VOLTAGE] / P[at.RATED_VOLTAGE]
    full = P[at.MAX_THRUST] * ratio * ratio
    for i in range(4):
        start = state[at.THRUST + i]
        target = commands[i] * full * P[at.GAIN + i]
        keep = at.KEEP_UP if target > start else at.KEEP_DOWN
        middle = target + (start - target) * P[keep]
        end = target + (start - target) * P[keep + 1]
        if end < LEAST_THRUST:
            middle, end = 0.0, 0.0
        thrust[0, i] = start
        thrust[1, i] = middle
        thrust[2, i] = end
        state[at.THRUST + i] = end
        turn_rotor(state, i, sqrt(middle / P[at.THRUST_SLOPE]), P)
        lag_nominal(state, i, commands[i], P)


@compiled
def drain_battery(state: Array, drop_v: float, P: Array) -> float:
    """Advance the battery by one sub-step and return the current in A.

    The open-circuit voltage falls linearly with the used charge. The voltage drop has an immediate and a slow resistive
    part. Electrical power is proportional to thrust^1.5 (momentum theory). drop_v: further drop, from a disturbance.
    """
    power = 0.0
    for i in range(4):
        thrust = state[at.THRUST + i]
        power += thrust * sqrt(thrust)
    current = P[at.IDLE_CURRENT] + P[at.POWER_FACTOR] * power / state[at.VOLTAGE]
    state[at.CHARGE_USED] += current * P[at.STEP]
    used = min(1.0, state[at.CHARGE_USED] / P[at.CAPACITY])
    target = current * P[at.POLARISATION_RESISTANCE]
    state[at.POLARISATION] = target + (state[at.POLARISATION] - target) * P[at.POLARISATION_KEEP]
    open_circuit = P[at.FULL_VOLTAGE] + (P[at.EMPTY_VOLTAGE] - P[at.FULL_VOLTAGE]) * used
    voltage = open_circuit - current * P[at.RESISTANCE] - state[at.POLARISATION] - drop_v
    state[at.VOLTAGE] = max(1.0, voltage)
    return float(current)
