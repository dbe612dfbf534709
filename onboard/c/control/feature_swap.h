/* The bumpless swap: new features in flight without a jump of nu_ad. The twin of onboard/control/feature_swap.py, which
 * explains it. W_new is the minimiser of
 *
 *     sum over recent states norm(W_new' Phi_bar(x_i) - W' Phi(x_i))^2 + mu norm(W_new - W_bar)^2 */
#ifndef DMRAC_FEATURE_SWAP_H
#define DMRAC_FEATURE_SWAP_H

#include "control/features.h"
#include "control/laws/kalman_state.h"

/* States of a swap: those of the ring, the present one, the one ahead, and that on the path now. */
#define RECENT_MAX (RING_MAX + 3)

/* Ring buffer of recent signal vectors, and of the filtered residual at each. */
typedef struct {
    real ring[RING_MAX * SIGNAL_COUNT];
    real residuals[RING_MAX * 3];
    int32_t size;
    int32_t filled;
    int32_t next;
    int64_t pushes; /* states added so far, those that were replaced counted too */
} RecentStates;

void recent_init(RecentStates *self, int32_t size);

/* Add one signal vector and the filtered residual there; they replace the oldest. */
void recent_push(RecentStates *self, const real signals[SIGNAL_COUNT], const real residual[3]);

/* The states of a swap, [n, SIGNAL_COUNT]: those of the ring, then `now` and `ahead`. Returns n; 0 while the ring is
 * empty. */
int32_t recent_states(const RecentStates *self, const real now[SIGNAL_COUNT], const real ahead[SIGNAL_COUNT],
                      real *states);

/* Signal vectors [n, SIGNAL_COUNT] and residuals [n, 3] of the ring, the oldest first. Returns n. */
int32_t recent_in_order(const RecentStates *self, real *states, real *residuals);

/* The result of planning a swap. */
typedef struct {
    real W[FEATURES_MAX * 3];     /* [k, 3], the last layer for the new features */
    real jump;                    /* eps_2: largest norm of the change of nu_ad over the recent states, units of u */
    Refusal refusal;              /* REFUSAL_NONE if the swap may be carried out */
    real theta[FEATURES_MAX * 3]; /* [k, 3], theta_n that flies with W */
    real step;                    /* the jump of nu_cmd, at the state ahead, units of u */
    KalmanState posterior;        /* X and S of the law with a covariance; the gradient law leaves it as it is */
} SwapPlan;

/* Memory for planning; it keeps nothing between two plans. */
typedef struct {
    real states[RECENT_MAX * SIGNAL_COUNT];
    real residuals[RING_MAX * 3];
    real Phi[FEATURES_MAX * RECENT_MAX];     /* [k, n] */
    real Phi_bar[FEATURES_MAX * RECENT_MAX]; /* [k, n] */
    real nu[3 * RECENT_MAX];                 /* [3, n] */
    real change[3 * RECENT_MAX];             /* [3, n] */
    real W_bar[FEATURES_MAX * 3];
    real square[2 * WIDTH_MAX * WIDTH_MAX + 2 * FEATURES_MAX];
} SwapWorkspace;

/* Plan the swap from `old` with W [k, 3] to `new_features` with theta_n `memory` [k_new, 3], over the n recent states in
 * `work`; with n = 0, W_new = theta_n. A theta_n outside the ball of weight_norm_max is refused. */
void plan_swap(const SwapConfig *config, const Features *old, const real *W, const Features *new_features,
               const real *memory, real weight_norm_max, int32_t n, SwapWorkspace *work, SwapPlan *plan);

/* Largest norm of the columns of a change of nu [3, n]; NaN if one is. */
real largest_column(const real *change, int32_t n);

/* The norm of one column. */
real column_norm(const real *change, int32_t n, int32_t column);

/* Resemblance of new to old features [k, n]: 1 - norm(Phi_bar - Phi) / norm(Phi), at least 0; the bias does not count. */
real resemblance(const real *Phi, const real *Phi_bar, int32_t k, int32_t n);

#endif
