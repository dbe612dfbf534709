/* The swap of the law with a covariance, in parts: W, b and S in the new features are the posterior on the recent states. The
 * twin of onboard/control/posterior_swap.py, which explains it. */
#ifndef DMRAC_POSTERIOR_SWAP_H
#define DMRAC_POSTERIOR_SWAP_H

#include "control/feature_swap.h"
#include "control/laws/kalman_last_layer.h"
#include "control/slope.h"
#include "control/version_test.h"

/* Columns of the present: here, on the path ahead, on the path now. */
#define SWAP_NOW 3

/* States of the ring at the start, those of the present, and those that are followed. */
#define SWAP_STATES_MAX (RING_MAX + SWAP_NOW + FOLLOWED_MAX)

/* Network, features, slopes, filter. */
#define SWAP_STAGES 4

typedef struct {
    Features features; /* the new ones */
    Refusal refusal;
    int32_t stage;
    int32_t part;               /* within the stage */
    int32_t parts[SWAP_STAGES]; /* of each stage */
    int32_t recent;             /* n */
    int32_t count;              /* of states */
    int32_t evaluated;          /* of them, whose features are known */
    int32_t used;               /* of the recent and followed ones, that the filter has taken */
    int64_t seen;               /* RecentStates.pushes */
    real states[SWAP_STATES_MAX * SIGNAL_COUNT];
    real residuals[SWAP_STATES_MAX * 3];
    real Phi[SWAP_STATES_MAX * FEATURES_MAX]; /* of each state [k] */
    real theta[FEATURES_MAX * 3];             /* [k, 3], within the limits of its slope once that is known */
    real shares[3];                           /* the largest slope at the recent states, share of its limit */
    real norms;                               /* product of the layers' spectral norms so far */
    real between;                             /* two recent states, s */
    real noise;                               /* variance of a measurement */
    KalmanState filter;
    RecentMap map; /* theta at the states that the filter has taken */
    NormWorkspace work;
} PosteriorSwap;

/* Start to prepare a swap to `channel`. now [SWAP_NOW, SIGNAL_COUNT]; tick and between: s, a tick, and between two recent
 * states. */
void posterior_swap_begin(PosteriorSwap *self, const KalmanLastLayer *law, const ChannelFeatures *channel,
                          const RecentStates *recent, const real *now, real tick, real between);

/* One part; whether it was the last one. With a refusal nothing is left to do. */
bool posterior_swap_step(PosteriorSwap *self, const SwapConfig *config, const KalmanLastLayer *law,
                         const SlopeLimits *limits);

/* Once a tick, before the part: take a state that has come, and what the parts before would do with it. */
void posterior_swap_follow(PosteriorSwap *self, const KalmanLastLayer *law, const RecentStates *recent);

/* The plan, once all parts are done, to replace the features `old`; the law stays as it is. since: s, from the newest recent
 * state to the present. */
void posterior_swap_plan(PosteriorSwap *self, const SwapConfig *config, const KalmanLastLayer *law, const Features *old,
                         const real *now, real since, SwapPlan *plan);

#endif
