"""Rotations in scalar arithmetic: for one quaternion at a time this is several times quicker than arrays.

Quaternions are wxyz, body FRD to world NED.
"""

from math import acos, atan2, cos, sin, sqrt

Quaternion = tuple[float, float, float, float]
Vector3 = tuple[float, float, float]


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
    sine = sqrt(x * x + y * y + z * z)
    scale = 2.0 if sine < 1e-9 else 2.0 * atan2(sine, w) / sine
    return x * scale, y * scale, z * scale


def attitude_for_thrust(down: Vector3, yaw_rad: float) -> Quaternion:
    """The attitude whose body down axis is `down` (unit vector, world NED) at the given yaw.

    `down` must not be horizontal along the yaw direction; the tilt limit of the controller sees to it.
    """
    # b3 = down; b2 = b3 x [cos yaw, sin yaw, 0] normalised; b1 = b2 x b3.
    cx, cy = cos(yaw_rad), sin(yaw_rad)
    b3x, b3y, b3z = down
    b2x, b2y, b2z = -b3z * cy, b3z * cx, b3x * cy - b3y * cx
    norm = sqrt(b2x * b2x + b2y * b2y + b2z * b2z)
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
        w = 0.5 * sqrt(1.0 + trace)
        k = 0.25 / w
        return w, (m21 - m12) * k, (m02 - m20) * k, (m10 - m01) * k
    if m00 >= m11 and m00 >= m22:
        x = 0.5 * sqrt(1.0 + m00 - m11 - m22)
        k = 0.25 / x
        return (m21 - m12) * k, x, (m01 + m10) * k, (m02 + m20) * k
    if m11 >= m22:
        y = 0.5 * sqrt(1.0 - m00 + m11 - m22)
        k = 0.25 / y
        return (m02 - m20) * k, (m01 + m10) * k, y, (m12 + m21) * k
    z = 0.5 * sqrt(1.0 - m00 - m11 + m22)
    k = 0.25 / z
    return (m10 - m01) * k, (m02 + m20) * k, (m12 + m21) * k, z


def tilt_angle(m22: float) -> float:
    """Angle [rad] between the body down axis and the world's, from the rotation matrix' last element."""
    return acos(min(1.0, max(-1.0, m22)))
