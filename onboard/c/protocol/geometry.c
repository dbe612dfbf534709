#include "protocol/geometry.h"

#include "numerics/elementary.h"

void vector_copy(const real a[3], real out[3]) {
    out[0] = a[0];
    out[1] = a[1];
    out[2] = a[2];
}

void vector_zero(real out[3]) {
    out[0] = out[1] = out[2] = REAL(0.0);
}

/* cross */
void vector_cross(const real a[3], const real b[3], real out[3]) {
    real x = a[1] * b[2] - a[2] * b[1];
    real y = a[2] * b[0] - a[0] * b[2];
    real z = a[0] * b[1] - a[1] * b[0];
    out[0] = x;
    out[1] = y;
    out[2] = z;
}

/* add */
void vector_add(const real a[3], const real b[3], real out[3]) {
    for (int i = 0; i < 3; i++) {
        out[i] = a[i] + b[i];
    }
}

/* subtract */
void vector_subtract(const real a[3], const real b[3], real out[3]) {
    for (int i = 0; i < 3; i++) {
        out[i] = a[i] - b[i];
    }
}

/* scale */
void vector_scale(const real v[3], real factor, real out[3]) {
    for (int i = 0; i < 3; i++) {
        out[i] = v[i] * factor;
    }
}

/* squared_length */
real vector_squared_length(const real v[3]) {
    return v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
}

/* math.hypot */
real vector_length(const real v[3]) {
    return real_sqrt(vector_squared_length(v));
}

/* matrix_times */
void matrix_times(const real R[9], const real v[3], real out[3]) {
    real x = v[0], y = v[1], z = v[2];
    out[0] = R[0] * x + R[1] * y + R[2] * z;
    out[1] = R[3] * x + R[4] * y + R[5] * z;
    out[2] = R[6] * x + R[7] * y + R[8] * z;
}

void matrix_transposed_times(const real R[9], const real v[3], real out[3]) {
    for (int i = 0; i < 3; i++) {
        out[i] = R[i] * v[0] + R[3 + i] * v[1] + R[6 + i] * v[2];
    }
}

/* quaternion_multiply */
void quaternion_multiply(const real a[4], const real b[4], real out[4]) {
    real aw = a[0], ax = a[1], ay = a[2], az = a[3];
    real bw = b[0], bx = b[1], by = b[2], bz = b[3];
    out[0] = aw * bw - ax * bx - ay * by - az * bz;
    out[1] = aw * bx + ax * bw + ay * bz - az * by;
    out[2] = aw * by - ax * bz + ay * bw + az * bx;
    out[3] = aw * bz + ax * by - ay * bx + az * bw;
}

/* (w, -x, -y, -z) */
void quaternion_conjugate(const real q[4], real out[4]) {
    out[0] = q[0];
    out[1] = -q[1];
    out[2] = -q[2];
    out[3] = -q[3];
}

/* rotate: v + 2 w (n x v) + 2 n x (n x v), n the vector part of q */
void rotate(const real q[4], const real v[3], real out[3]) {
    real w = q[0], x = q[1], y = q[2], z = q[3];
    real a = v[0], b = v[1], c = v[2];
    real tx = REAL(2.0) * (y * c - z * b);
    real ty = REAL(2.0) * (z * a - x * c);
    real tz = REAL(2.0) * (x * b - y * a);
    out[0] = a + w * tx + y * tz - z * ty;
    out[1] = b + w * ty + z * tx - x * tz;
    out[2] = c + w * tz + x * ty - y * tx;
}

/* quaternion_to_rotation_vector */
void quaternion_to_rotation_vector(const real q[4], real out[3]) {
    real sign = q[0] < REAL(0.0) ? REAL(-1.0) : REAL(1.0);
    real w = sign * q[0], x = sign * q[1], y = sign * q[2], z = sign * q[3];
    real sine = real_sqrt(x * x + y * y + z * z);
    real scale = sine < REAL(1e-9) ? REAL(2.0) : REAL(2.0) * real_atan2(sine, w) / sine;
    out[0] = x * scale;
    out[1] = y * scale;
    out[2] = z * scale;
}

void turn_between(const real from[4], const real to[4], real out[3]) {
    real inverse[4], turn[4];
    quaternion_conjugate(from, inverse);
    quaternion_multiply(inverse, to, turn);
    quaternion_to_rotation_vector(turn, out);
}

/* attitude_for_thrust: b3 = down; b2 = b3 x [cos yaw, sin yaw, 0] normalised; b1 = b2 x b3 */
void attitude_for_thrust(const real down[3], real yaw_rad, real out[4]) {
    real cx = real_cos(yaw_rad), cy = real_sin(yaw_rad);
    real b3x = down[0], b3y = down[1], b3z = down[2];
    real b2x = -b3z * cy, b2y = b3z * cx, b2z = b3x * cy - b3y * cx;
    real norm = real_sqrt(b2x * b2x + b2y * b2y + b2z * b2z);
    b2x = b2x / norm;
    b2y = b2y / norm;
    b2z = b2z / norm;
    real b1x = b2y * b3z - b2z * b3y;
    real b1y = b2z * b3x - b2x * b3z;
    real b1z = b2x * b3y - b2y * b3x;
    const real m[9] = {b1x, b2x, b3x, b1y, b2y, b3y, b1z, b2z, b3z};
    rotation_to_quaternion(m, out);
}

/* rotation_to_quaternion */
void rotation_to_quaternion(const real m[9], real out[4]) {
    real m00 = m[0], m01 = m[1], m02 = m[2], m10 = m[3], m11 = m[4], m12 = m[5], m20 = m[6], m21 = m[7], m22 = m[8];
    real trace = m00 + m11 + m22;
    if (trace > real_max(real_max(m00, m11), m22)) {
        real w = REAL(0.5) * real_sqrt(REAL(1.0) + trace);
        real k = REAL(0.25) / w;
        out[0] = w;
        out[1] = (m21 - m12) * k;
        out[2] = (m02 - m20) * k;
        out[3] = (m10 - m01) * k;
    } else if (m00 >= m11 && m00 >= m22) {
        real x = REAL(0.5) * real_sqrt(REAL(1.0) + m00 - m11 - m22);
        real k = REAL(0.25) / x;
        out[0] = (m21 - m12) * k;
        out[1] = x;
        out[2] = (m01 + m10) * k;
        out[3] = (m02 + m20) * k;
    } else if (m11 >= m22) {
        real y = REAL(0.5) * real_sqrt(REAL(1.0) - m00 + m11 - m22);
        real k = REAL(0.25) / y;
        out[0] = (m02 - m20) * k;
        out[1] = (m01 + m10) * k;
        out[2] = y;
        out[3] = (m12 + m21) * k;
    } else {
        real z = REAL(0.5) * real_sqrt(REAL(1.0) - m00 - m11 + m22);
        real k = REAL(0.25) / z;
        out[0] = (m10 - m01) * k;
        out[1] = (m02 + m20) * k;
        out[2] = (m12 + m21) * k;
        out[3] = z;
    }
}

/* tilt_angle */
real tilt_angle(real m22) {
    return real_acos(real_min(REAL(1.0), real_max(REAL(-1.0), m22)));
}

/* rotation_of */
void rotation_of(const real q[4], real out[9]) {
    real w = q[0], x = q[1], y = q[2], z = q[3];
    real xx = x * x, yy = y * y, zz = z * z;
    real xy = x * y, xz = x * z, yz = y * z;
    real wx = w * x, wy = w * y, wz = w * z;
    out[0] = REAL(1.0) - REAL(2.0) * (yy + zz);
    out[1] = REAL(2.0) * (xy - wz);
    out[2] = REAL(2.0) * (xz + wy);
    out[3] = REAL(2.0) * (xy + wz);
    out[4] = REAL(1.0) - REAL(2.0) * (xx + zz);
    out[5] = REAL(2.0) * (yz - wx);
    out[6] = REAL(2.0) * (xz - wy);
    out[7] = REAL(2.0) * (yz + wx);
    out[8] = REAL(1.0) - REAL(2.0) * (xx + yy);
}

/* euler_of */
void euler_of(const real R[9], real out[3]) {
    real roll = real_atan2(R[7], R[8]);
    real pitch = real_asin(real_min(REAL(1.0), real_max(REAL(-1.0), -R[6])));
    real yaw = real_atan2(R[3], R[0]);
    out[0] = roll;
    out[1] = pitch;
    out[2] = yaw;
}

/* quaternion_of */
void quaternion_of(real roll, real pitch, real yaw, real out[4]) {
    real cr = real_cos(roll / REAL(2.0)), sr = real_sin(roll / REAL(2.0));
    real cp = real_cos(pitch / REAL(2.0)), sp = real_sin(pitch / REAL(2.0));
    real cy = real_cos(yaw / REAL(2.0)), sy = real_sin(yaw / REAL(2.0));
    out[0] = cr * cp * cy + sr * sp * sy;
    out[1] = sr * cp * cy - cr * sp * sy;
    out[2] = cr * sp * cy + sr * cp * sy;
    out[3] = cr * cp * sy - sr * sp * cy;
}

/* unit_product */
void unit_product(const real a[4], const real b[4], real out[4]) {
    quaternion_multiply(a, b, out);
    real w = out[0], x = out[1], y = out[2], z = out[3];
    real scale = REAL(1.5) - REAL(0.5) * (w * w + x * x + y * y + z * z);
    for (int i = 0; i < 4; i++) {
        out[i] *= scale;
    }
}

/* quaternion_of_rotation_vector */
void quaternion_of_rotation_vector(const real phi[3], real out[4]) {
    real x = phi[0], y = phi[1], z = phi[2];
    real angle = real_sqrt(x * x + y * y + z * z);
    bool small = angle < REAL(1e-6);
    real s = small ? REAL(0.5) : real_sin(REAL(0.5) * angle) / angle;
    out[0] = small ? REAL(1.0) : real_cos(REAL(0.5) * angle);
    out[1] = s * x;
    out[2] = s * y;
    out[3] = s * z;
}

/* rotation_between */
void rotation_between(const real measured[4], const real rotation[9], real out[3]) {
    real m[9];
    rotation_of(measured, m);
    real a = rotation[0], b = rotation[1], c = rotation[2];
    real d = rotation[3], e = rotation[4], f = rotation[5];
    real g = rotation[6], h = rotation[7], i = rotation[8];
    real r10 = m[3] * a + m[4] * b + m[5] * c;
    real r20 = m[6] * a + m[7] * b + m[8] * c;
    real r01 = m[0] * d + m[1] * e + m[2] * f;
    real r21 = m[6] * d + m[7] * e + m[8] * f;
    real r02 = m[0] * g + m[1] * h + m[2] * i;
    real r12 = m[3] * g + m[4] * h + m[5] * i;
    real trace = (m[0] * a + m[1] * b + m[2] * c) + (m[3] * d + m[4] * e + m[5] * f) + (m[6] * g + m[7] * h + m[8] * i);
    real x = r21 - r12, y = r02 - r20, z = r10 - r01;
    real s = REAL(0.5) * real_sqrt(x * x + y * y + z * z);
    real angle = real_atan2(s, REAL(0.5) * (trace - REAL(1.0)));
    if (s < REAL(1e-9)) {
        /* No rotation, or half a turn, for which any axis will do: it is far outside every gate. */
        out[0] = angle < REAL(1.0) ? REAL(0.0) : REAL_PI;
        out[1] = out[2] = REAL(0.0);
        return;
    }
    real scale = REAL(0.5) * angle / s;
    out[0] = x * scale;
    out[1] = y * scale;
    out[2] = z * scale;
}

/* turned_about_vertical */
void turned_about_vertical(const real turn[3], const real v[3], real out[3]) {
    real c = real_cos(turn[2]), s = real_sin(turn[2]);
    real x = c * v[0] - s * v[1];
    real y = s * v[0] + c * v[1];
    out[0] = x;
    out[1] = y;
    out[2] = v[2];
}
