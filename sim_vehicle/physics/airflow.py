"""What acts at every sub-step besides the vehicle itself: air velocity, cloth and battery sag. Compiled.

The rows are built by world.py from the disturbances' records; the meaning of their values is stated there.
"""

from math import cos, exp, pi, sin, sqrt

import sim_vehicle.physics.layout as at
from sim_vehicle.physics.compiled import compiled
from sim_vehicle.physics.dynamics import Vector, cross, rotation, to_body
from sim_vehicle.records import Array

HALF_WIDTH_GROWTH = 0.11
"""Half-width of a round turbulent jet per metre from the nozzle (Pope, Turbulent Flows, section 5.1: 0.094-0.11)."""
CENTRE_LINE_DECAY = 6.2
"""Centre-line speed is this times D/x of the nozzle's speed (the same source: 5.8-6.3)."""
LEAST_ADVECTION = 0.2
"""m/s: gusts also change for a vehicle that hangs in still air."""
LN2 = 0.6931471805599453


@compiled
def is_active(row: Array, time_s: float) -> bool:
    """Whether a row acts at this time; a nanosecond of slack covers rounding of the time."""
    return bool(row[at.ROW_ONSET] <= time_s + 1.0e-9 < row[at.ROW_END])


@compiled
def jet_velocity(v: Array, n: float, e: float, d: float) -> Vector:
    """Air velocity, m/s NED, of a round turbulent jet at a point.

    v: nozzle's position [3] m, unit direction [3], diameter m, speed m/s at the nozzle. Gaussian profile; on the
    centre line constant speed in the potential core, then 6.2 D/x; half-width D/2 near the nozzle, then 0.11 x.
    Upstream of the nozzle the air is still.
    """
    rn, re, rd = n - v[0], e - v[1], d - v[2]
    x = rn * v[3] + re * v[4] + rd * v[5]
    if x <= 0.0:
        return (0.0, 0.0, 0.0)
    across = max(0.0, rn * rn + re * re + rd * rd - x * x)
    half_width = max(0.5 * v[6], HALF_WIDTH_GROWTH * x)
    centre = v[7] * min(1.0, CENTRE_LINE_DECAY * v[6] / x)
    speed = centre * exp(-LN2 * across / (half_width * half_width))
    return (speed * v[3], speed * v[4], speed * v[5])


@compiled
def advance_gust(gust: Array, v: Array, speed: float, step_s: float, noise: Array) -> None:
    """Per axis y = a y + sigma sqrt(1 - a^2) n, a = exp(-V dt/L): exact, and of variance sigma^2 at any speed V.

    gust: [>=3] m/s, in place. v: sigma m/s, L m, V m/s or -1 for `speed`. noise: [3] unit normal.
    """
    advection = v[2] if v[2] >= 0.0 else max(LEAST_ADVECTION, speed)
    a = exp(-advection * step_s / v[1])
    b = v[0] * sqrt(1.0 - a * a)
    for i in range(3):
        gust[i] = a * gust[i] + b * noise[i]


@compiled
def air_velocity(state: Array, rows: Array, row_state: Array, time_s: float, step_s: float, noise: Array) -> Vector:
    """Air velocity, m/s NED, at the vehicle; advances the gusts. noise: [rows, 3]."""
    n, e, d = 0.0, 0.0, 0.0
    for j in range(rows.shape[0]):
        if not is_active(rows[j], time_s):
            continue
        v = rows[j, at.ROW_VALUES :]
        if rows[j, at.ROW_KIND] == at.KIND_WIND:
            n, e, d = n + v[0], e + v[1], d + v[2]
        elif rows[j, at.ROW_KIND] == at.KIND_JET:
            jet = jet_velocity(v, state[0], state[1], state[2])
            n, e, d = n + jet[0], e + jet[1], d + jet[2]
    speed = sqrt((n - state[3]) ** 2 + (e - state[4]) ** 2 + (d - state[5]) ** 2)
    for j in range(rows.shape[0]):
        if rows[j, at.ROW_KIND] == at.KIND_GUSTS and is_active(rows[j], time_s):
            gust = row_state[j]
            advance_gust(gust, rows[j, at.ROW_VALUES :], speed, step_s, noise[j])
            n, e, d = n + gust[0], e + gust[1], d + gust[2]
    return (n, e, d)


@compiled
def advance_cloth(cloth: Array, v: Array, state: Array, step_s: float, gravity: float, n1: float) -> Vector:
    """Force, N NED, of a hanging cloth on its fastening, and the cloth's state one sub-step on.

    v: mass kg, pendulum length m, damping ratio, drag N at 3 m/s, modulation, share across the wind, Strouhal number
    over side 1/m, fastening m below O. A bob on small angles (semi-implicit step) gives the inertial part; drag
    v[3] (V/3)^2 passes straight to the frame, modulated by a narrow-band flapping whose phase is that of an oscillator
    with phase noise, at a frequency of Strouhal number times V over the cloth's side, kept within 4..12 Hz.
    """
    an, ae, ad = state[at.ACCELERATION], state[at.ACCELERATION + 1], state[at.ACCELERATION + 2]
    stiffness = gravity / v[1]
    damping = 2.0 * v[2] * sqrt(stiffness)
    cloth[2] += step_s * (-stiffness * cloth[0] - damping * cloth[2] - an)
    cloth[3] += step_s * (-stiffness * cloth[1] - damping * cloth[3] - ae)
    cloth[0] += step_s * cloth[2]
    cloth[1] += step_s * cloth[3]
    n = v[0] * (stiffness * cloth[0] + damping * cloth[2])
    e = v[0] * (stiffness * cloth[1] + damping * cloth[3])
    wn, we = state[at.WIND] - state[3], state[at.WIND + 1] - state[4]
    speed = sqrt(wn * wn + we * we)
    frequency = min(12.0, max(4.0, v[6] * speed))
    cloth[4] += 2.0 * pi * frequency * step_s + sqrt(2.0 * pi * FLAPPING_BANDWIDTH * step_s) * n1
    cloth[4] -= 2.0 * pi * int(cloth[4] / (2.0 * pi))
    if speed > 1.0e-6:
        drag = v[3] * (speed / 3.0) ** 2
        along = drag * (1.0 + v[4] * sin(cloth[4])) / speed
        across = drag * v[5] * v[4] * cos(cloth[4]) / speed
        n += along * wn - across * we
        e += along * we + across * wn
    return (n, e, v[0] * max(0.0, gravity - ad))


FLAPPING_BANDWIDTH = 0.5
"""Hz, full width at half maximum of the flapping's spectral line."""


@compiled
def outside_load(
    state: Array, rows: Array, row_state: Array, time_s: float, P: Array, noise: Array, load: Array
) -> float:
    """Force N NED and torque N m body of the cloths into load[6]; gives the battery's further drop in V."""
    for i in range(6):
        load[i] = 0.0
    drop_v = 0.0
    for j in range(rows.shape[0]):
        if not is_active(rows[j], time_s):
            continue
        v = rows[j, at.ROW_VALUES :]
        if rows[j, at.ROW_KIND] == at.KIND_CLOTH:
            f = advance_cloth(row_state[j], v, state, P[at.STEP], P[at.GRAVITY], noise[j, 0])
            b = to_body(rotation(state[6], state[7], state[8], state[9]), f[0], f[1], f[2])
            t = cross((0.0, 0.0, v[7]), b)
            for i in range(3):
                load[i] += f[i]
                load[3 + i] += t[i]
        elif rows[j, at.ROW_KIND] == at.KIND_SAG:
            drop_v += v[0] * (1.0 - exp(-(time_s - rows[j, at.ROW_ONSET]) / v[1]))
    return drop_v
