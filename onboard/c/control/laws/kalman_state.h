/* Mean X and covariance S of a Kalman filter whose states revert to their prior, each at a rate of its own. The twin of
 * onboard/control/laws/kalman_state.py, which explains it.
 *
 *     predict:  X <- D X,                       S <- D S D + (I - D^2) S0,    D = diag(exp(-s_i dt)), S0 diagonal
 *     correct:  X <- X + g (y - X'phi)' / v,    S <- S - g g' / v,            g = S phi,  v = R + phi'S phi
 *
 * S stays symmetric and positive definite for any number of steps, in float as well, as long as `rounding_share` of the twin
 * is below 1. Each number of S is computed once and stored on both sides of the diagonal.
 *
 * With -DDMRAC_WHOLE_COVARIANCE S is in whole numbers of 32 bits, for processors without floating-point unit: S_ij over
 * sqrt(S0_ii S0_jj), which is at most 1, with 30 fractional bits. Sums are 64 bits wide. A step rounds each number by 1e-9; a
 * prediction adds (1 - d_i^2) to the diagonal, 2.5e-4 of `dmrac`. X and nu stay in `real`; their products with
 * the features are of whole numbers too (products.h). The library on the Mambo is built so (mambo/build.py). */
#ifndef DMRAC_KALMAN_STATE_H
#define DMRAC_KALMAN_STATE_H

#include "control/laws/products.h"

/* A number of S. */
#ifdef DMRAC_WHOLE_COVARIANCE
typedef int32_t covariance;
#else
typedef real covariance;
#endif

typedef struct {
    int32_t size;                          /* n */
    real prior_variance[STATES_MAX];       /* the diagonal of S0 */
    real rates[STATES_MAX];                /* s_i, 1/s */
    real X[STATES_MAX * 3];                /* [n, 3] */
    covariance S[STATES_MAX * STATES_MAX]; /* [n, n] */
    real dt;                               /* of `keep` and `gain`, s */
    real keep[STATES_MAX];                 /* diagonal of D */
    real gain[STATES_MAX];                 /* diagonal of (I - D^2) S0 */
#ifdef DMRAC_WHOLE_COVARIANCE
    real root[STATES_MAX];     /* sqrt(S0) */
    real inverse[STATES_MAX];  /* 1 / root, with 29 fractional bits */
    real to_whole[STATES_MAX]; /* units of columns and products */
    real of_whole[STATES_MAX];
    int32_t loss[STATES_MAX]; /* 1 - d_i, with 31 fractional bits */
    bool broken;              /* a number that is not finite, or too large, has come into S: it is not used any more */
#endif
} KalmanState;

/* Start from X = 0 and S = S0. `prior_variance` and `rates` [n]. */
void kalman_state_init(KalmanState *self, const real *prior_variance, const real *rates, int32_t size);

/* The same numbers as `from`, in a state that need not have been started. */
void kalman_state_copy(KalmanState *self, const KalmanState *from);

/* X <- D X, S <- D S D + (I - D^2) S0, over dt, s. */
void kalman_state_predict(KalmanState *self, real dt);

/* Whether S holds finite numbers only. */
bool kalman_state_is_finite(const KalmanState *self);

/* S: itself if it is in `real`, else `space` [n, n] with its numbers. */
const real *kalman_state_dense(const KalmanState *self, real *space);

/* A column of S, [n]. */
void kalman_state_column(const KalmanState *self, int32_t column, real *out);

/* g [n] = S column, of a column whose first `count` numbers, at most `most` in size, are given and whose others are zero. */
void kalman_state_product(const KalmanState *self, const real *column, int32_t count, real most, real *g);

/* The same of numbers of at most 1, and x = X'column. */
void kalman_state_along(const KalmanState *self, const real *column, int32_t count, real *g, real x[3]);

/* X <- X + g innovation' / v, S <- S - g g' / v, with g [n] = S phi, innovation = y - X'phi and v = R + phi'S phi. */
void kalman_state_correct(KalmanState *self, const real *g, const real innovation[3], real v);

/* mu >= 0, and Y = (I + mu S)^-1 X whose norm is the radius, for S [n, n] and X [n, columns] with a larger norm; n at most
 * STATES_MAX, at most 3 columns. Where rounding, or numbers that are not finite, leave S not positive semidefinite, the search
 * may end early: mu is smaller then, at least zero. `work`: n^2 numbers. */
real multiplier(const real *S, const real *X, int32_t n, int32_t columns, real radius, real *Y, real *work);

#endif
