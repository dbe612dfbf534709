/* Elementary functions of the core's own. They use only + - * / and sqrt, which IEEE 754 rounds correctly, so every
 * machine gets the same bits, in double and in float, if the compiler fuses nothing (-ffp-contract=off).
 *
 * Errors, in units in the last place (ulp), as tests/onboard/c/test_elementary.py measures them:
 *   real_exp, real_sin, real_cos               below 1 (sin and cos in float: up to 100 rad, beyond it below 1e-7)
 *   real_atan2                                 below 1.5
 *   real_expm1, real_tanh, real_asin, real_acos, real_tan  below 2.5
 * Special values (infinities, zeros, NaN) follow C99's annex F unless said otherwise.
 */
#ifndef DMRAC_ELEMENTARY_H
#define DMRAC_ELEMENTARY_H

#include <stdbool.h>
#include <stdint.h>

#include "numerics/real.h"

#define REAL_PI REAL(3.14159265358979323846)

/* sin, cos and tan take angles up to this size, rad. Beyond it they return NaN. */
#ifdef DMRAC_FLOAT
#define ANGLE_MAX REAL(8192.0)
#else
#define ANGLE_MAX REAL(823549.0)
#endif

real real_exp(real x);

/* exp(x) - 1, without cancellation near zero. */
real real_expm1(real x);
real real_tanh(real x);
real real_sin(real x);
real real_cos(real x);
real real_tan(real x);

/* Arguments are finite. */
real real_atan2(real y, real x);

/* Arguments within [-1, 1]; others give NaN. */
real real_asin(real x);
real real_acos(real x);

real real_sqrt(real x);
real real_abs(real x);

/* The smaller and the larger of two, as Python's min(a, b) and max(a, b): the first if they are equal or one is NaN. */
real real_min(real a, real b);
real real_max(real a, real b);

/* The larger of two, as numpy's maximum: NaN if one of them is. */
real real_largest(real a, real b);

/* min(max(x, low), high). */
real real_clip(real x, real low, real high);

/* The largest whole number that is not above x; |x| below 2^62. */
real real_floor(real x);

bool real_is_finite(real x);

/* An angle [rad] that grows with time, for sin and cos: in float, what is left of it after whole turns. */
real angle_within_turn(double angle);

#endif
