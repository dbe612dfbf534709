/* The algorithms and coefficients of exp, expm1, tanh, sin, cos and atan are those of fdlibm:
 *
 *   Copyright (C) 1993 by Sun Microsystems, Inc. All rights reserved.
 *   Developed at SunPro, a Sun Microsystems, Inc. business. Permission to use, copy, modify, and distribute this
 *   software is freely granted, provided that this notice is preserved.
 *
 * The float coefficients of exp, expm1 and atan are those of its conversion by Ian Lance Taylor, Cygnus Support. The
 * float coefficients of sin and cos are near-minimax polynomials on [-pi/4, pi/4].
 */
#include "numerics/elementary.h"

#include <math.h>
#include <string.h>

#ifdef DMRAC_FLOAT

#define EXP_OVERFLOW 88.7228317f
#define EXP_UNDERFLOW (-103.972076f)
#define LN2_HIGH 6.9314575195e-01f
#define LN2_LOW 1.4286067653e-06f
#define EXP_TERMS 2
static const real EXP_P[EXP_TERMS] = {1.6666625440e-01f, -2.7667332906e-03f};
#define EXPM1_TERMS 2
static const real EXPM1_Q[EXPM1_TERMS] = {-3.3333212137e-02f, 1.5807170421e-03f};
#define TANH_ONE 9.0f
#define TANH_TINY 2.4414062e-04f
#define EXPM1_LARGE 23
#define EXPM1_MIDDLE 23
#define EXPONENT_BIAS 127
#define MANTISSA_BITS 23
#define EXPONENT_MIN (-126)

/* pi / 2 in three parts; the first two have so few bits that a product with a small whole number is exact. */
static const real HALF_PI[3] = {1.5703125f, 4.837512969970703125e-04f, 7.549789954891882e-08f};
#define SIN_TERMS 3
static const real SIN_S[SIN_TERMS] = {-1.6666654611e-01f, 8.3321608736e-03f, -1.9515295891e-04f};
#define COS_TERMS 3
static const real COS_C[COS_TERMS] = {4.166664568298827e-02f, -1.388731625493765e-03f, 2.443315711809948e-05f};

#define ATAN_TERMS 5
static const real ATAN_T[ATAN_TERMS] = {3.3333328366e-01f, -1.9999158382e-01f, 1.4253635705e-01f, -1.0648017377e-01f,
                                        6.1687607318e-02f};
static const real ATAN_HIGH[4] = {4.6364760399e-01f, 7.8539812565e-01f, 9.8279368877e-01f, 1.5707962513e+00f};
static const real ATAN_LOW[4] = {5.0121582440e-09f, 3.7748947079e-08f, 3.4473217170e-08f, 7.5497894159e-08f};
#define PI_LOW (-8.7422776573e-08f)

#else

#define EXP_OVERFLOW 7.09782712893383973096e+02
#define EXP_UNDERFLOW (-7.45133219101941108420e+02)
#define LN2_HIGH 6.93147180369123816490e-01
#define LN2_LOW 1.90821492927058770002e-10
#define EXP_TERMS 5
static const real EXP_P[EXP_TERMS] = {1.66666666666666019037e-01, -2.77777777770155933842e-03,
                                      6.61375632143793436117e-05, -1.65339022054652515390e-06,
                                      4.13813679705723846039e-08};
#define EXPM1_TERMS 5
static const real EXPM1_Q[EXPM1_TERMS] = {-3.33333333333331316428e-02, 1.58730158725481460165e-03,
                                          -7.93650757867487942473e-05, 4.00821782732936239552e-06,
                                          -2.01099218183624371326e-07};
#define TANH_ONE 22.0
#define TANH_TINY 2.7755575615628914e-17
#define EXPM1_LARGE 56
#define EXPM1_MIDDLE 20
#define EXPONENT_BIAS 1023
#define MANTISSA_BITS 52
#define EXPONENT_MIN (-1022)

static const real HALF_PI[3] = {1.57079632673412561417e+00, 6.07710050630396597660e-11, 2.02226624871116645580e-21};
#define HALF_PI_REST 8.47842766036889956997e-32
#define SIN_TERMS 6
static const real SIN_S[SIN_TERMS] = {-1.66666666666666324348e-01, 8.33333333332248946124e-03,
                                      -1.98412698298579493134e-04, 2.75573137070700676789e-06,
                                      -2.50507602534068634195e-08, 1.58969099521155010221e-10};
#define COS_TERMS 6
static const real COS_C[COS_TERMS] = {4.16666666666666019037e-02, -1.38888888888741095749e-03,
                                      2.48015872894767294178e-05, -2.75573143513906633035e-07,
                                      2.08757232129817482790e-09, -1.13596475577881948265e-11};

#define ATAN_TERMS 11
static const real ATAN_T[ATAN_TERMS] = {
    3.33333333333329318027e-01, -1.99999999998764832476e-01, 1.42857142725034663711e-01, -1.11111104054623557880e-01,
    9.09088713343650656196e-02, -7.69187620504482999495e-02, 6.66107313738753120669e-02, -5.83357013379057348645e-02,
    4.97687799461593236017e-02, -3.65315727442169155270e-02, 1.62858201153657823623e-02};
static const real ATAN_HIGH[4] = {4.63647609000806093515e-01, 7.85398163397448278999e-01, 9.82793723247329054082e-01,
                                  1.57079632679489655800e+00};
static const real ATAN_LOW[4] = {2.26987774529616870924e-17, 3.06161699786838301793e-17, 1.39033110312309984516e-17,
                                 6.12323399573676603587e-17};
#define PI_LOW 1.2246467991473531772e-16

#endif

#define TWO_OVER_PI REAL(6.36619772367581382433e-01)
#define ONE_OVER_LN2 REAL(1.44269504088896338700e+00)

/* c[0] + z (c[1] + z (c[2] + ...)), by Horner's rule. */
static real polynomial(const real *c, int count, real z) {
    real sum = c[count - 1];
    for (int i = count - 2; i >= 0; i--) {
        sum = c[i] + z * sum;
    }
    return sum;
}

/* 2^k for an exponent of a normal number. */
static real power_of_two(int k) {
    real value;
#ifdef DMRAC_FLOAT
    uint32_t bits = (uint32_t)(k + EXPONENT_BIAS) << MANTISSA_BITS;
#else
    uint64_t bits = (uint64_t)(k + EXPONENT_BIAS) << MANTISSA_BITS;
#endif
    memcpy(&value, &bits, sizeof value);
    return value;
}

/* The nearest whole number; halves away from zero. */
static int nearest(real x) {
    return (int)(x + (x < REAL(0.0) ? REAL(-0.5) : REAL(0.5)));
}

real real_abs(real x) {
#ifdef DMRAC_FLOAT
    return fabsf(x);
#else
    return fabs(x);
#endif
}

/* IEEE 754 demands a correctly rounded square root, so it is the same everywhere without code of our own. */
real real_sqrt(real x) {
#ifdef DMRAC_FLOAT
    return sqrtf(x);
#else
    return sqrt(x);
#endif
}

real real_min(real a, real b) {
    return b < a ? b : a;
}

real real_max(real a, real b) {
    return b > a ? b : a;
}

real real_largest(real a, real b) {
    return b > a || b != b ? b : a;
}

real real_clip(real x, real low, real high) {
    return real_min(real_max(x, low), high);
}

real real_floor(real x) {
    real whole = (real)(int64_t)x;
    return whole > x ? whole - REAL(1.0) : whole;
}

bool real_is_finite(real x) {
    return x - x == REAL(0.0);
}

/* x = k ln 2 + r, r = high - low; exp(r) = 1 + r c / (2 - c) + r with c = r - r^2 P(r^2). */
real real_exp(real x) {
    if (x != x) {
        return x;
    }
    if (x > EXP_OVERFLOW) {
        return REAL(HUGE_VAL);
    }
    if (x < EXP_UNDERFLOW) {
        return REAL(0.0);
    }
    int k = nearest(ONE_OVER_LN2 * x);
    real high = x - (real)k * LN2_HIGH;
    real low = (real)k * LN2_LOW;
    real r = high - low;
    real t = r * r;
    real c = r - t * polynomial(EXP_P, EXP_TERMS, t);
    real y = REAL(1.0) - ((low - (r * c) / (REAL(2.0) - c)) - high);
    if (k < EXPONENT_MIN) {
        return y * power_of_two(k + MANTISSA_BITS + 1) * power_of_two(-MANTISSA_BITS - 1);
    }
    return k > EXPONENT_BIAS ? y * REAL(2.0) * power_of_two(k - 1) : y * power_of_two(k);
}

/* exp(x) - 1 without cancellation, for |x| <= 2 TANH_ONE. */
static real exp_minus_one(real x) {
    int k = real_abs(x) <= REAL(0.34657359) ? 0 : nearest(ONE_OVER_LN2 * x);
    real high = x - (real)k * LN2_HIGH;
    real low = (real)k * LN2_LOW;
    real r = high - low;
    real c = (high - r) - low;
    real half = REAL(0.5) * r;
    real square = r * half;
    real r1 = REAL(1.0) + square * polynomial(EXPM1_Q, EXPM1_TERMS, square);
    real t = REAL(3.0) - r1 * half;
    real e = square * ((r1 - t) / (REAL(6.0) - r * t));
    if (k == 0) {
        return r - (r * e - square);
    }
    e = r * (e - c) - c;
    e -= square;
    if (k == -1) {
        return REAL(0.5) * (r - e) - REAL(0.5);
    }
    if (k == 1) {
        return r < REAL(-0.25) ? REAL(-2.0) * (e - (r + REAL(0.5))) : REAL(1.0) + REAL(2.0) * (r - e);
    }
    if (k <= -2 || k > EXPM1_LARGE) {
        return (REAL(1.0) - (e - r)) * power_of_two(k) - REAL(1.0);
    }
    if (k < EXPM1_MIDDLE) {
        return ((REAL(1.0) - power_of_two(-k)) - (e - r)) * power_of_two(k);
    }
    return ((r - (e + power_of_two(-k))) + REAL(1.0)) * power_of_two(k);
}

real real_expm1(real x) {
    if (real_abs(x) <= REAL(2.0) * TANH_ONE) {
        return exp_minus_one(x);
    }
    return real_exp(x) - REAL(1.0);
}

real real_tanh(real x) {
    real size = real_abs(x);
    if (x != x || size < TANH_TINY) {
        return x;
    }
    real z = REAL(1.0);
    if (size < REAL(1.0)) {
        real t = exp_minus_one(REAL(-2.0) * size);
        z = -t / (t + REAL(2.0));
    } else if (size < TANH_ONE) {
        z = REAL(1.0) - REAL(2.0) / (exp_minus_one(REAL(2.0) * size) + REAL(2.0));
    }
    return x < REAL(0.0) ? -z : z;
}

/* x = n pi / 2 + (y + rest) with |y| <= pi / 4 or little more; returns n modulo 4. */
static int reduce(real x, real *y, real *rest) {
    int n = nearest(x * TWO_OVER_PI);
    real k = (real)n;
    real r = x - k * HALF_PI[0];
    real before = r;
    real w = k * HALF_PI[1];
    r = before - w;
    real lost = (before - r) - w;
    before = r;
    w = k * HALF_PI[2];
    r = before - w;
#ifdef DMRAC_FLOAT
    w = -(((before - r) - w) + lost);
#else
    w = k * HALF_PI_REST - (((before - r) - w) + lost);
#endif
    *y = r - w;
    *rest = (r - *y) - w;
    return n & 3;
}

static real sine_kernel(real x, real rest) {
    real z = x * x;
    real v = z * x;
    real r = polynomial(SIN_S + 1, SIN_TERMS - 1, z);
    return x - ((z * (REAL(0.5) * rest - v * r) - rest) - v * SIN_S[0]);
}

static real cosine_kernel(real x, real rest) {
    real z = x * x;
    real r = z * polynomial(COS_C, COS_TERMS, z);
    real half = REAL(0.5) * z;
    real w = REAL(1.0) - half;
    return w + (((REAL(1.0) - w) - half) + (z * r - x * rest));
}

/* sin(x + quarters pi / 2). */
static real sine_after(real x, int quarters) {
    if (!(real_abs(x) <= ANGLE_MAX)) {
        return REAL(NAN);
    }
    real y, rest;
    int n = (reduce(x, &y, &rest) + quarters) & 3;
    real value = n & 1 ? cosine_kernel(y, rest) : sine_kernel(y, rest);
    return n & 2 ? -value : value;
}

real real_sin(real x) {
    return sine_after(x, 0);
}

real real_cos(real x) {
    return sine_after(x, 1);
}

real real_tan(real x) {
    return real_sin(x) / real_cos(x);
}

/* atan of a number that is not negative. */
static real atan_of(real x) {
    int id = -1;
    if (x >= REAL(2.4375)) {
        id = 3;
        x = REAL(-1.0) / x;
    } else if (x >= REAL(1.1875)) {
        id = 2;
        x = (x - REAL(1.5)) / (REAL(1.0) + REAL(1.5) * x);
    } else if (x >= REAL(0.6875)) {
        id = 1;
        x = (x - REAL(1.0)) / (x + REAL(1.0));
    } else if (x >= REAL(0.4375)) {
        id = 0;
        x = (REAL(2.0) * x - REAL(1.0)) / (REAL(2.0) + x);
    }
    real z = x * x;
    real tail = x * (z * polynomial(ATAN_T, ATAN_TERMS, z));
    return id < 0 ? x - tail : ATAN_HIGH[id] - ((tail - ATAN_LOW[id]) - x);
}

/* Whether the sign bit is set, of zero as well. */
static bool is_negative(real x) {
    return x < REAL(0.0) || (x == REAL(0.0) && REAL(1.0) / x < REAL(0.0));
}

real real_atan2(real y, real x) {
    if (x != x || y != y) {
        return x + y;
    }
    real z = y == REAL(0.0) ? REAL(0.0) : x == REAL(0.0) ? ATAN_HIGH[3] + ATAN_LOW[3] : atan_of(real_abs(y / x));
    if (is_negative(x) && x != REAL(0.0)) {
        z = REAL_PI - (z - PI_LOW);
    } else if (is_negative(x) && y == REAL(0.0)) {
        z = REAL_PI;
    }
    return is_negative(y) ? -z : z;
}

real real_asin(real x) {
    return real_atan2(x, real_sqrt((REAL(1.0) - x) * (REAL(1.0) + x)));
}

real real_acos(real x) {
    return real_atan2(real_sqrt((REAL(1.0) - x) * (REAL(1.0) + x)), x);
}

/* In double the reduction of sin and cos does it better. */
real angle_within_turn(double angle) {
#ifdef DMRAC_FLOAT
    const double turn = 6.283185307179586476925;
    int64_t turns = (int64_t)(angle / turn);
    if ((double)turns * turn > angle) {
        turns--;
    }
    return (real)(angle - (double)turns * turn);
#else
    return angle;
#endif
}
