"""Rotations, on tuples of floats: for one quaternion at a time this is several times faster than numpy arrays.

Quaternions are wxyz, body FRD to world NED (docs/conventions.md).
"""

import math
from collections.abc import Iterable
from typing import Final

import numpy as np

from protocol.conventions import Array

Quaternion = tuple[float, float, float, float]
Vector3 = tuple[float, float, float]
Rotation = tuple[float, float, float, float, float, float, float, float, float]
"""A rotation matrix, row by row."""
ZERO: Final[Vector3] = (0.0, 0.0, 0.0)


def vector(values: Iterable[float]) -> Vector3:
    """Three numbers as a tuple, for an equation that is written axis by axis."""
    x, y, z = values
    return x, y, z


def cross(a: Vector3, b: Vector3) -> Vector3:
    """The vector product a x b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def add(a: Vector3, b: Vector3) -> Vector3:
    """a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def subtract(a: Vector3, b: Vector3) -> Vector3:
    """a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def scale(v: Vector3, factor: float) -> Vector3:
    """v times a number."""
    return v[0] * factor, v[1] * factor, v[2] * factor


def matrix_times(R: Rotation, v: Vector3) -> Vector3:
    """R v."""
    x, y, z = v
    return R[0] * x + R[1] * y + R[2] * z, R[3] * x + R[4] * y + R[5] * z, R[6] * x + R[7] * y + R[8] * z


def normalised(q: Quaternion) -> Quaternion:
    """The quaternion with length 1; `q` must not be zero."""
    w, x, y, z = q
    factor = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
    return w * factor, x * factor, y * factor, z * factor


def quaternion_multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    """Hamilton product a b."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def rotate(q: Quaternion, v: Vector3) -> Vector3:
    """The vector v turned by the unit quaternion q: v + 2 w (n x v) + 2 n x (n x v), n its vector part."""
    w, x, y, z = q
    a, b, c = v
    tx, ty, tz = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    return (
        a + w * tx + y * tz - z * ty,
        b + w * ty + z * tx - x * tz,
        c + w * tz + x * ty - y * tx,
    )


def quaternion_to_rotation_vector(q: Quaternion) -> Vector3:
    """Axis times angle [rad], the shorter way round."""
    w, x, y, z = q
    if w < 0.0:
        w, x, y, z = -w, -x, -y, -z
    sine = math.sqrt(x * x + y * y + z * z)
    scale = 2.0 if sine < 1e-9 else 2.0 * math.atan2(sine, w) / sine
    return x * scale, y * scale, z * scale


def attitude_for_thrust(down: Vector3, yaw_rad: float) -> Quaternion:
    """The attitude whose body down axis is `down` (unit vector, world NED) at the given yaw.

    `down` must not be horizontal along the yaw direction; the tilt limit of the controller sees to it.
    """
    # b3 = down; b2 = b3 x [cos yaw, sin yaw, 0] normalised; b1 = b2 x b3.
    cx, cy = math.cos(yaw_rad), math.sin(yaw_rad)
    b3x, b3y, b3z = down
    b2x, b2y, b2z = -b3z * cy, b3z * cx, b3x * cy - b3y * cx
    norm = math.sqrt(b2x * b2x + b2y * b2y + b2z * b2z)
    b2x, b2y, b2z = b2x / norm, b2y / norm, b2z / norm
    b1x = b2y * b3z - b2z * b3y
    b1y = b2z * b3x - b2x * b3z
    b1z = b2x * b3y - b2y * b3x
    return rotation_to_quaternion(b1x, b2x, b3x, b1y, b2y, b3y, b1z, b2z, b3z)


def rotation_to_quaternion(
    m00: float, m01: float, m02: float, m10: float, m11: float, m12: float, m20: float, m21: float, m22: float
) -> Quaternion:
    """Quaternion of a rotation matrix given row by row (Shepperd 1978: the largest component first)."""
    trace = m00 + m11 + m22
    if trace > max(m00, m11, m22):
        w = 0.5 * math.sqrt(1.0 + trace)
        k = 0.25 / w
        return w, (m21 - m12) * k, (m02 - m20) * k, (m10 - m01) * k
    if m00 >= m11 and m00 >= m22:
        x = 0.5 * math.sqrt(1.0 + m00 - m11 - m22)
        k = 0.25 / x
        return (m21 - m12) * k, x, (m01 + m10) * k, (m02 + m20) * k
    if m11 >= m22:
        y = 0.5 * math.sqrt(1.0 - m00 + m11 - m22)
        k = 0.25 / y
        return (m02 - m20) * k, (m01 + m10) * k, y, (m12 + m21) * k
    z = 0.5 * math.sqrt(1.0 - m00 - m11 + m22)
    k = 0.25 / z
    return (m10 - m01) * k, (m02 + m20) * k, (m12 + m21) * k, z


def tilt_angle(m22: float) -> float:
    """Angle [rad] between the body down axis and the world's, from the rotation matrix' last element."""
    return math.acos(min(1.0, max(-1.0, m22)))


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


def euler_of(R: Rotation) -> Vector3:
    """Roll, pitch and yaw (yaw-pitch-roll sequence) of a rotation body to world, rad."""
    return math.atan2(R[7], R[8]), math.asin(min(1.0, max(-1.0, -R[6]))), math.atan2(R[3], R[0])


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


def unit_product(a: Quaternion, b: Quaternion) -> Quaternion:
    """Hamilton product, scaled to unit length to first order."""
    w, x, y, z = quaternion_multiply(a, b)
    scale = 1.5 - 0.5 * (w * w + x * x + y * y + z * z)
    return (w * scale, x * scale, y * scale, z * scale)


def quaternion_of_rotation_vector(phi: Vector3) -> Quaternion:
    """Unit quaternion of a rotation vector, rad."""
    x, y, z = phi
    angle = math.sqrt(x * x + y * y + z * z)
    if angle < 1e-6:
        return (1.0, 0.5 * x, 0.5 * y, 0.5 * z)
    s = math.sin(0.5 * angle) / angle
    return (math.cos(0.5 * angle), s * x, s * y, s * z)


def rotation_between(measured: Quaternion, rotation: Rotation) -> Vector3:
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
        # No rotation, or half a turn, for which any axis will do: it is far outside every gate.
        return (0.0, 0.0, 0.0) if angle < 1.0 else (math.pi, 0.0, 0.0)
    scale = 0.5 * angle / s
    return (x * scale, y * scale, z * scale)


def turned_about_vertical(turn: Vector3, v: Vector3) -> Vector3:
    """`v` rotated about the vertical by the vertical part of `turn`."""
    c, s = math.cos(turn[2]), math.sin(turn[2])
    return (c * v[0] - s * v[1], s * v[0] + c * v[1], v[2])


def squared_length(v: Vector3) -> float:
    """Square of the length."""
    return v[0] * v[0] + v[1] * v[1] + v[2] * v[2]


def roll_pitch_yaw(q: Array) -> Array:
    """Return roll, pitch and yaw, [n, 3], rad, of quaternions [n, 4]; on arrays, for the evaluation of logs."""
    w, x, y, z = q.T
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    angles: Array = np.stack([roll, pitch, yaw], axis=1)
    return angles
