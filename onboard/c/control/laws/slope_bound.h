/* The slope of W'Phi over the state, kept within its limits while W is learnt. The twin of
 * onboard/control/laws/slope_bound.py, which explains it. For an axis with weights w, A = dPhi'/dx in units that make the limit
 * 1, and norm(A w) > 1:
 *
 *     X <- X - mu S A'y,    y = (I + mu A S A')^-1 A w,    mu > 0 so that norm(y) = 1 */
#ifndef DMRAC_SLOPE_BOUND_H
#define DMRAC_SLOPE_BOUND_H

#include "control/laws/kalman_state.h"
#include "control/slope.h"

/* Inputs that a loop knows. */
#define SLOPE_INPUTS_MAX (3 * SLOPE_GROUPS)

/* Memory of a check; it keeps nothing between two of them. */
typedef struct {
    real J[WIDTH_MAX * SLOPE_INPUTS_MAX];             /* dPhi/dx, [k - 1, n], without the constant */
    real along[STATES_MAX * SLOPE_INPUTS_MAX];        /* S J, [k + 1, n] */
    real among[SLOPE_INPUTS_MAX * SLOPE_INPUTS_MAX];  /* J'S J, [n, n] */
    real scaled[SLOPE_INPUTS_MAX * SLOPE_INPUTS_MAX]; /* A S A' of an axis */
    real factor[SLOPE_INPUTS_MAX * SLOPE_INPUTS_MAX];
} SlopeWorkspace;

/* The bound for the features of one channel. */
typedef struct {
    int32_t count;                    /* n, inputs that the loop knows */
    int32_t inputs[SLOPE_INPUTS_MAX]; /* which of the features' inputs they are */
    real units[3 * SLOPE_INPUTS_MAX]; /* [3, n], one over the limit of each axis */
    int32_t ticks;                    /* since the last check */
    SlopeWorkspace work;
} SlopeBound;

/* selection: the inputs that the features see. */
void slope_bound_init(SlopeBound *self, const FeatureSelection *selection, const SlopeLimits *limits);

/* One tick: every SLOPE_PERIOD_TICKS-th bounds the slope of (theta + X)'Phi at the signals, theta [k, 3]. */
void slope_bound_step(SlopeBound *self, const Features *features, const real signals[SIGNAL_COUNT], const real *theta,
                      KalmanState *state);

/* Project the X of every axis onto the weights whose slope is within its limit, in the metric of S^-1. `work->J` is given for
 * n inputs; units [3, n]: the slope of an axis is norm((theta + X)'J units). */
void bound_slopes(KalmanState *state, const real *theta, const real *units, int32_t n, SlopeWorkspace *work);

#endif
