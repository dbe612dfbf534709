"""Rigid body: forces, torques, floor contact and one Runge-Kutta step. Compiled; see compiled.py.

Theory of operation. The state is that of a reference point O fixed in the frame (the centre of mass of the bare
vehicle). A payload moves the centre of mass C to r_c from O. With F the sum of all forces but weight, and tau its
torque about O,

    J_C omega_dot = tau - r_c x F - omega x J_C omega
    a_O = g + F/m - omega_dot x r_c - omega x (omega x r_c)

World NED, body FRD, quaternion wxyz body to world. Floor at d = 0.
"""

from math import sqrt

import sim_vehicle.physics.layout as at
from protocol.conventions import Array
from protocol.geometry import Rotation, Vector3
from sim_vehicle.physics.compiled import compiled, inlined

FLOOR_REACH = 0.15
"""m; a vehicle whose reference point is higher cannot touch the floor. It exceeds the distance of every part from O."""


@compiled
def rotation(w: float, x: float, y: float, z: float) -> Rotation:
    """Body-to-world matrix, row by row, of a quaternion of about unit length."""
    s = 2.0 / (w * w + x * x + y * y + z * z)
    return (
        1.0 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y),
        s * (x * y + w * z), 1.0 - s * (x * x + z * z), s * (y * z - w * x),
        s * (x * z - w * y), s * (y * z + w * x), 1.0 - s * (x * x + y * y),
    )  # fmt: skip


@compiled
def to_world(R: Rotation, x: float, y: float, z: float) -> Vector3:
    """R v."""
    return (R[0] * x + R[1] * y + R[2] * z, R[3] * x + R[4] * y + R[5] * z, R[6] * x + R[7] * y + R[8] * z)


@compiled
def to_body(R: Rotation, n: float, e: float, d: float) -> Vector3:
    """R' v."""
    return (R[0] * n + R[3] * e + R[6] * d, R[1] * n + R[4] * e + R[7] * d, R[2] * n + R[5] * e + R[8] * d)


@compiled
def cross(a: Vector3, b: Vector3) -> Vector3:
    """Vector3 product a x b."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@compiled
def symmetric(m: Array, start: int, v: Vector3) -> Vector3:
    """M v for the symmetric matrix with xx yy zz xy xz yz from m[start] on."""
    xx, yy, zz, xy, xz, yz = m[start], m[start + 1], m[start + 2], m[start + 3], m[start + 4], m[start + 5]
    return (xx * v[0] + xy * v[1] + xz * v[2], xy * v[0] + yy * v[1] + yz * v[2], xz * v[0] + yz * v[1] + zz * v[2])


@compiled
def contact_point(i: int, P: Array) -> Vector3:
    """Body position, m, of contact point i: 0..3 the feet, 4..7 the rims of the rotors (on its back)."""
    x = P[at.FOOT_X] if (i & 1) == 0 else -P[at.FOOT_X]
    y = P[at.FOOT_Y] if (i & 2) == 0 else -P[at.FOOT_Y]
    return (x, y, P[at.FOOT_DROP] if i < 4 else -P[at.ROTOR_HEIGHT])


@compiled
def lowest_point(x: Array, R: Rotation, P: Array) -> float:
    """Down coordinate, m, of the lowest contact point; positive: in the floor."""
    lowest = -1.0e9
    for i in range(8):
        r = contact_point(i, P)
        lowest = max(lowest, x[at.POSITION + 2] + R[6] * r[0] + R[7] * r[1] + R[8] * r[2])
    return lowest


@compiled
def floor_contact(x: Array, R: Rotation, rates: Vector3, P: Array) -> tuple[float, float, float, float, float, float]:
    """Force, N, and torque about O, N m, both body, of the floor: spring, damper, friction limited by Coulomb's law."""
    force = (0.0, 0.0, 0.0)
    torque = (0.0, 0.0, 0.0)
    for i in range(8):
        r = contact_point(i, P)
        depth = x[at.POSITION + 2] + R[6] * r[0] + R[7] * r[1] + R[8] * r[2]
        if depth <= 0.0:
            continue
        turn = cross(rates, r)
        v = to_world(R, turn[0], turn[1], turn[2])
        n, e, d = x[at.VELOCITY] + v[0], x[at.VELOCITY + 1] + v[1], x[at.VELOCITY + 2] + v[2]
        press = max(0.0, P[at.CONTACT_STIFFNESS] * depth + P[at.CONTACT_DAMPING] * d)
        grip = min(P[at.CONTACT_GRIP], P[at.FRICTION] * press / (sqrt(n * n + e * e) + 1.0e-9))
        f = to_body(R, -grip * n, -grip * e, -press)
        t = cross(r, f)
        force = (force[0] + f[0], force[1] + f[1], force[2] + f[2])
        torque = (torque[0] + t[0], torque[1] + t[1], torque[2] + t[2])
    return (force[0], force[1], force[2], torque[0], torque[1], torque[2])


@inlined
def rotor_place(i: int, P: Array) -> tuple[float, float]:
    """Forward and right body coordinate, m, of rotor i: 0..3, PX4 order."""
    front = 1.0 if (i == 0 or i == 2) else -1.0  # PX4: front right, rear left, front left, rear right
    right = 1.0 if (i == 0 or i == 3) else -1.0
    return (front * P[at.ARM_X], right * P[at.ARM_Y])


@inlined
def rotor_lift(i: int, down: float, R: Rotation, thrust: float, P: Array) -> float:
    """Thrust, N, of rotor i with its damage and the ground effect. thrust: of the undamaged rotor.

    The ground effect 1 + k (R/4z)^2 depends on the height z of each rotor above the floor, and is constant below z = R
    (form of Cheeseman and Bennett with a fitted k).
    """
    rx, ry = rotor_place(i, P)
    height = -(down + R[6] * rx + R[7] * ry - R[8] * P[at.ROTOR_HEIGHT])
    quotient = P[at.ROTOR_RADIUS] / (4.0 * max(height, P[at.ROTOR_RADIUS]))
    return float(thrust * P[at.THRUST_FACTOR + i] * (1.0 + P[at.GROUND_EFFECT] * quotient * quotient))


@inlined
def rotor_drag_torque(i: int, thrust: float, P: Array) -> float:
    """Torque, N m about body down, of rotor i on the frame. thrust: of the undamaged rotor."""
    spin = 1.0 if i < 2 else -1.0  # a counter-clockwise rotor turns the frame clockwise, + yaw
    return float(spin * P[at.TORQUE_RATIO] * P[at.TORQUE_FACTOR + i] * thrust)


@compiled
def rotor_wrench(down: float, R: Rotation, thrust: Array, P: Array) -> tuple[float, float, float, float]:
    """Total thrust, N, and its torque about O, body N m."""
    total, roll, pitch, yaw = 0.0, 0.0, 0.0, 0.0
    for i in range(4):
        rx, ry = rotor_place(i, P)
        T = rotor_lift(i, down, R, thrust[i], P)
        total += T
        roll -= ry * T
        pitch += rx * T
        yaw += rotor_drag_torque(i, thrust[i], P)
    return (total, roll, pitch, yaw)


@inlined
def airframe_drag(x: Array, R: Rotation, wind: Array, P: Array) -> tuple[Vector3, Vector3]:
    """Force, N, and torque about O, N m, both body, of the air on the airframe. x: [13], wind: [3], see `derivative`.

    The drag acts at the rotor plane, on the air velocity there.
    """
    hub = (0.0, 0.0, -P[at.ROTOR_HEIGHT])
    turn = cross((x[10], x[11], x[12]), hub)
    air = to_body(R, x[3] - wind[0], x[4] - wind[1], x[5] - wind[2])
    u = (air[0] + turn[0], air[1] + turn[1], air[2] + turn[2])
    c = -(P[at.DRAG_LINEAR] + P[at.DRAG_QUADRATIC] * sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2]))
    drag = (c * u[0], c * u[1], c * u[2])
    return drag, cross(hub, drag)


@compiled
def derivative(x: Array, thrust: Array, wind: Array, load: Array, P: Array, dx: Array) -> None:
    """Time derivative of the rigid-body state.

    Parameters
    ----------
    x: [13] position, velocity, quaternion, rates.
    thrust: [4] N, of undamaged rotors.
    wind: [3] m/s, air velocity, NED.
    load: [6] further force, N, NED, and torque about O, N m, body.
    P: [PARAMETERS_SIZE].
    dx: [13] out.
    """
    R = rotation(x[6], x[7], x[8], x[9])
    rates = (x[10], x[11], x[12])
    lift, roll, pitch, yaw = rotor_wrench(x[2], R, thrust, P)
    drag, drag_torque = airframe_drag(x, R, wind, P)
    push = to_body(R, load[0], load[1], load[2])
    F = (drag[0] + push[0], drag[1] + push[1], drag[2] + push[2] - lift)
    tau = (roll + drag_torque[0] + load[3], pitch + drag_torque[1] + load[4], yaw + drag_torque[2] + load[5])
    if x[2] > -FLOOR_REACH:
        floor = floor_contact(x, R, rates, P)
        F = (F[0] + floor[0], F[1] + floor[1], F[2] + floor[2])
        tau = (tau[0] + floor[3], tau[1] + floor[4], tau[2] + floor[5])
    centre = (P[at.CENTRE], P[at.CENTRE + 1], P[at.CENTRE + 2])
    moment = cross(centre, F)
    gyro = cross(rates, symmetric(P, at.INERTIA, rates))
    rest = (tau[0] - moment[0] - gyro[0], tau[1] - moment[1] - gyro[1], tau[2] - moment[2] - gyro[2])
    alpha = symmetric(P, at.INVERSE, rest)
    lever = cross(alpha, centre)
    swing = cross(rates, cross(rates, centre))
    m = P[at.MASS]
    a = to_world(R, F[0] / m - lever[0] - swing[0], F[1] / m - lever[1] - swing[1], F[2] / m - lever[2] - swing[2])
    dx[0], dx[1], dx[2] = x[3], x[4], x[5]
    dx[3], dx[4], dx[5] = a[0], a[1], a[2] + P[at.GRAVITY]
    dx[6] = -0.5 * (x[7] * rates[0] + x[8] * rates[1] + x[9] * rates[2])
    dx[7] = 0.5 * (x[6] * rates[0] + x[8] * rates[2] - x[9] * rates[1])
    dx[8] = 0.5 * (x[6] * rates[1] + x[9] * rates[0] - x[7] * rates[2])
    dx[9] = 0.5 * (x[6] * rates[2] + x[7] * rates[1] - x[8] * rates[0])
    dx[10], dx[11], dx[12] = alpha[0], alpha[1], alpha[2]


@compiled
def runge_kutta(state: Array, thrust: Array, wind: Array, load: Array, P: Array, work: Array) -> None:
    """One classical fourth-order step of the rigid body, state[0:13] in place. Normalises the quaternion.

    thrust: [3, 4] at the start, middle and end. wind, load: constant over the sub-step. work: [5, 13].
    """
    h = P[at.STEP]
    k1, k2, k3, k4, x = work[0], work[1], work[2], work[3], work[4]
    derivative(state, thrust[0], wind, load, P, k1)
    for i in range(at.RIGID):
        x[i] = state[i] + 0.5 * h * k1[i]
    derivative(x, thrust[1], wind, load, P, k2)
    for i in range(at.RIGID):
        x[i] = state[i] + 0.5 * h * k2[i]
    derivative(x, thrust[1], wind, load, P, k3)
    for i in range(at.RIGID):
        x[i] = state[i] + h * k3[i]
    derivative(x, thrust[2], wind, load, P, k4)
    for i in range(at.RIGID):
        state[i] += h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])
    s = 1.0 / sqrt(state[6] * state[6] + state[7] * state[7] + state[8] * state[8] + state[9] * state[9])
    for i in range(at.QUATERNION, at.QUATERNION + 4):
        state[i] *= s
