/* Mean X and covariance S of a Kalman filter whose states revert to their prior, each at a rate of its own. The twin of
 * onboard/control/laws/kalman_state.py, which explains it.
 *
 *     predict:  X <- D X,                       S <- D S D + (I - D^2) S0,    D = diag(exp(-s_i dt)), S0 diagonal
 *     correct:  X <- X + g (y - X'phi)' / v,    S <- S - g g' / v,            g = S phi,  v = R + phi'S phi
 *
 * S stays symmetric and positive definite for any number of steps, in float as well, as long as `rounding_share` of the twin
 * is below 1. Each number of S is computed once and stored on both sides of the diagonal. */
#ifndef DMRAC_KALMAN_STATE_H
#define DMRAC_KALMAN_STATE_H

#include "control/features.h"

/* The features and the fast bias. */
#define STATES_MAX (FEATURES_MAX + 1)

typedef struct {
    int32_t size;                    /* n */
    real prior_variance[STATES_MAX]; /* the diagonal of S0 */
    real rates[STATES_MAX];          /* s_i, 1/s */
    real X[STATES_MAX * 3];          /* [n, 3] */
    real S[STATES_MAX * STATES_MAX]; /* [n, n] */
    real dt;                         /* of `keep` and `gain`, s */
    real keep[STATES_MAX];           /* diagonal of D */
    real gain[STATES_MAX];           /* diagonal of (I - D^2) S0 */
} KalmanState;

/* Start from X = 0 and S = S0. `prior_variance` and `rates` [n]. */
void kalman_state_init(KalmanState *self, const real *prior_variance, const real *rates, int32_t size);

/* X <- D X, S <- D S D + (I - D^2) S0, over dt, s. */
void kalman_state_predict(KalmanState *self, real dt);

/* g [n] = S column and x = X'column, of a column whose first `count` numbers are given and whose others are zero. */
void kalman_state_along(const KalmanState *self, const real *column, int32_t count, real *g, real x[3]);

/* X <- X + g innovation' / v, S <- S - g g' / v, with g [n] = S phi, innovation = y - X'phi and v = R + phi'S phi. */
void kalman_state_correct(KalmanState *self, const real *g, const real innovation[3], real v);

/* mu >= 0, and Y = (I + mu S)^-1 X whose norm is the radius, for S [n, n] and X [n, columns] with a larger norm; n at most
 * STATES_MAX, at most 3 columns. Where rounding, or numbers that are not finite, leave S not positive semidefinite, the search
 * may end early: mu is smaller then, at least zero. `work`: n^2 numbers. */
real multiplier(const real *S, const real *X, int32_t n, int32_t columns, real radius, real *Y, real *work);

#endif
