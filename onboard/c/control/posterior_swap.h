/* The swap of the law with a covariance: W, b and S in the new features are the posterior on the recent states. The twin of
 * onboard/control/posterior_swap.py, which explains it. numpy solves one system over all states; here the filter runs over
 * them, one after the other: the same X and S, in memory of k^2 instead of n^2 numbers. */
#ifndef DMRAC_POSTERIOR_SWAP_H
#define DMRAC_POSTERIOR_SWAP_H

#include "control/feature_swap.h"
#include "control/laws/kalman_last_layer.h"
#include "control/slope.h"

/* Durations of a swap, s. */
typedef struct {
    real tick;    /* a tick */
    real between; /* between two recent states */
    real since;   /* from the newest one to the present */
} SwapTimes;

/* Plan the swap from `old` features with the state of `law` to `new_features`, with the theta_n that came with them. now
 * [3, SIGNAL_COUNT]: the present state, the path ahead, and the path now. */
void plan_posterior_swap(const SwapConfig *config, const KalmanLastLayer *law, const Features *old,
                         const Features *new_features, const SlopeLimits *limits, const RecentStates *recent,
                         const real *now, const SwapTimes *times, SwapWorkspace *work, SwapPlan *plan);

/* X = [W - theta; b] and S given the residuals y [n, 3] at n states, the oldest first, whose features stand in the first n
 * columns of Phi [k, columns]. */
void posterior(const KalmanLastLayer *law, const real *theta, const real *Phi, int32_t columns, int32_t k,
               const real *y, int32_t n, const SwapTimes *times, KalmanState *out);

#endif
