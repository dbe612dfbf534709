/* Rotations: the twin of protocol/geometry.py. Quaternions are wxyz, body FRD to world NED; a rotation matrix is nine
 * numbers, row by row. `out` may be one of the inputs. */
#ifndef DMRAC_GEOMETRY_H
#define DMRAC_GEOMETRY_H

#include "numerics/real.h"

/* out = a. */
void vector_copy(const real a[3], real out[3]);
void vector_zero(real out[3]);
/* out = a x b. */
void vector_cross(const real a[3], const real b[3], real out[3]);
void vector_add(const real a[3], const real b[3], real out[3]);
void vector_subtract(const real a[3], const real b[3], real out[3]);
/* out = v times a number. */
void vector_scale(const real v[3], real factor, real out[3]);
real vector_squared_length(const real v[3]);
real vector_length(const real v[3]);
/* out = R v. */
void matrix_times(const real R[9], const real v[3], real out[3]);
/* out = R' v; not in place. */
void matrix_transposed_times(const real R[9], const real v[3], real out[3]);

/* Hamilton product a b. */
void quaternion_multiply(const real a[4], const real b[4], real out[4]);
/* The inverse of a unit quaternion. */
void quaternion_conjugate(const real q[4], real out[4]);
/* v turned by the unit quaternion q. */
void rotate(const real q[4], const real v[3], real out[3]);
/* Axis times angle [rad], the shorter way round. */
void quaternion_to_rotation_vector(const real q[4], real out[3]);
/* out = from^-1 to, as a rotation vector, rad. */
void turn_between(const real from[4], const real to[4], real out[3]);
/* The attitude whose body down axis is `down` (unit vector, world NED) at the given yaw. `down` must not be horizontal
 * along the yaw direction. */
void attitude_for_thrust(const real down[3], real yaw_rad, real out[4]);
/* Quaternion of a rotation matrix (Shepperd 1978: the largest component first). */
void rotation_to_quaternion(const real m[9], real out[4]);
/* Angle [rad] between the body down axis and the world's, from the last element of the rotation matrix. */
real tilt_angle(real m22);
/* Rotation matrix (body to world) of a unit quaternion. */
void rotation_of(const real q[4], real out[9]);
/* Roll, pitch and yaw (yaw-pitch-roll sequence), rad. */
void euler_of(const real R[9], real out[3]);
/* Unit quaternion of the yaw-pitch-roll sequence; rad. */
void quaternion_of(real roll, real pitch, real yaw, real out[4]);
/* Hamilton product, scaled to unit length to first order. */
void unit_product(const real a[4], const real b[4], real out[4]);
/* Unit quaternion of a rotation vector, rad. */
void quaternion_of_rotation_vector(const real phi[3], real out[4]);
/* World-frame rotation vector that turns `rotation` into `measured`: log(R_m R^T), rad. */
void rotation_between(const real measured[4], const real rotation[9], real out[3]);
/* v rotated about the vertical by the vertical part of `turn`. */
void turned_about_vertical(const real turn[3], const real v[3], real out[3]);

#endif
