"""Attitude arithmetic of the estimator, on tuples of floats. Quaternions are wxyz, body FRD to world NED."""

import math

from onboard.records import Vector

Rotation = tuple[float, float, float, float, float, float, float, float, float]
"""A rotation matrix, row by row."""
Quaternion = tuple[float, float, float, float]


def rotation_of(q: Quaternion) -> Rotation:
    """Rotation matrix (body to world) of a unit quaternion wxyz."""
    w, x, y, z = q
    xx, yy, zz = x * x, y * y, z * z
    xy, xz, yz = x * y, x * z, y * z
    wx, wy, wz = w * x, w * y, w * z
    return (
        1.0 - 2.0 * (yy + zz),
        2.0 * (xy - wz),
        2.0 * (xz + wy),
        2.0 * (xy + wz),
        1.0 - 2.0 * (xx + zz),
        2.0 * (yz - wx),
        2.0 * (xz - wy),
        2.0 * (yz + wx),
        1.0 - 2.0 * (xx + yy),
    )


def quaternion_of(roll: float, pitch: float, yaw: float) -> Quaternion:
    """Unit quaternion wxyz of the yaw-pitch-roll sequence; rad."""
    cr, sr = math.cos(roll / 2), math.sin(roll / 2)
    cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def product(a: Quaternion, b: Quaternion) -> Quaternion:
    """Hamilton product, scaled to unit length to first order."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    w = aw * bw - ax * bx - ay * by - az * bz
    x = aw * bx + ax * bw + ay * bz - az * by
    y = aw * by - ax * bz + ay * bw + az * bx
    z = aw * bz + ax * by - ay * bx + az * bw
    scale = 1.5 - 0.5 * (w * w + x * x + y * y + z * z)
    return (w * scale, x * scale, y * scale, z * scale)


def exponential(phi: Vector) -> Quaternion:
    """Unit quaternion of a rotation vector, rad."""
    x, y, z = phi
    angle = math.sqrt(x * x + y * y + z * z)
    if angle < 1e-6:
        return (1.0, 0.5 * x, 0.5 * y, 0.5 * z)
    s = math.sin(0.5 * angle) / angle
    return (math.cos(0.5 * angle), s * x, s * y, s * z)


def rotation_between(measured: Quaternion, rotation: Rotation) -> Vector:
    """World-frame rotation vector that turns `rotation` into `measured`: log(R_m R^T), rad."""
    m = rotation_of(measured)
    a, b, c, d, e, f, g, h, i = rotation
    r10 = m[3] * a + m[4] * b + m[5] * c
    r20 = m[6] * a + m[7] * b + m[8] * c
    r01 = m[0] * d + m[1] * e + m[2] * f
    r21 = m[6] * d + m[7] * e + m[8] * f
    r02 = m[0] * g + m[1] * h + m[2] * i
    r12 = m[3] * g + m[4] * h + m[5] * i
    trace = (m[0] * a + m[1] * b + m[2] * c) + (m[3] * d + m[4] * e + m[5] * f) + (m[6] * g + m[7] * h + m[8] * i)
    x, y, z = r21 - r12, r02 - r20, r10 - r01
    s = 0.5 * math.sqrt(x * x + y * y + z * z)
    angle = math.atan2(s, 0.5 * (trace - 1.0))
    if s < 1e-9:
        # Either no rotation or half a turn; for half a turn any axis is as good: it is far outside every gate.
        return (0.0, 0.0, 0.0) if angle < 1.0 else (math.pi, 0.0, 0.0)
    scale = 0.5 * angle / s
    return (x * scale, y * scale, z * scale)


def turned_about_vertical(turn: Vector, v: Vector) -> Vector:
    """`v` rotated about the vertical by the vertical part of `turn`."""
    c, s = math.cos(turn[2]), math.sin(turn[2])
    return (c * v[0] - s * v[1], s * v[0] + c * v[1], v[2])


def squared(v: Vector) -> float:
    """Square of the length."""
    return v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
