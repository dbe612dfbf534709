/* MRAC and DMRAC: nu_ad = W' Phi(x, c), with a last-layer law: the gradient law, or the one with a covariance. The twin of
 * onboard/control/laws/adaptive.py. */
#ifndef DMRAC_ADAPTIVE_H
#define DMRAC_ADAPTIVE_H

#include "control/feature_swap.h"
#include "control/features.h"
#include "control/laws/kalman_last_layer.h"
#include "control/laws/last_layer.h"
#include "control/laws/law.h"
#include "control/laws/slope_bound.h"
#include "control/posterior_swap.h"

/* The features of a channel and all that its law has learnt with them. */
typedef struct {
    Features features;
    real theta[FEATURES_MAX * 3];          /* [k, 3], the trained last layer */
    real W[STATES_MAX * 3];                /* [k, 3]; with a covariance: X = [W - theta; b], [k + 1, 3] */
    covariance S[STATES_MAX * STATES_MAX]; /* [k + 1, k + 1], with a covariance only */
} Learnt;

/* One channel's features, last layer, and swap. Of the two last layers only that of config.law.kind is used. */
typedef struct {
    AdaptiveConfig config;
    SlopeLimits slope_limits;
    Features features;
    TrackingWeights tracking_weights; /* of e in the tracking term */
    LastLayer last_layer;             /* LAW_GRADIENT */
    KalmanLastLayer kalman_layer;     /* LAW_KALMAN */
    SlopeBound slope_bound;           /* LAW_KALMAN that learns */
    RecentStates recent;
    real signals[3 *
                 SIGNAL_COUNT]; /* of the last tick: at the present, ahead, and on the path now (adaptive_reads_path) */
    int64_t ticks;
    real dt; /* of the last tick, s */
    real Delta_hat[3];
    real eps_1_squared;
    real eps_2;
} Adaptive;

/* The features of the start are set with features_init_...(&self->features) before. */
void adaptive_init(Adaptive *self, const AdaptiveConfig *config, const ChannelGains *gains,
                   const SlopeLimits *slope_limits);

/* Largest slope of a trained map, as shares of the loop's gains. The gradient law reads its map at the vehicle: the loop's own
 * gain. */
SlopeShares adaptive_slope_shares(const AdaptiveConfig *config);

/* Whether the map is read on the path ahead, and not at the state ahead. */
bool adaptive_reads_path(const Adaptive *self);

/* Update W with Phi(x); nu_ad is nu_cmd. */
void adaptive_step(Adaptive *self, const ChannelState *channel, ChannelTelemetry *telemetry, real nu_ad[3]);

/* Reset the filters. W and the features stay. */
void adaptive_reset(Adaptive *self);

/* Whether the features may be replaced by trained ones. */
bool adaptive_learns(const Adaptive *self);

/* Largest jump of a swap, units of u. */
real adaptive_jump_max(const Adaptive *self);

/* Gains of the law: lambda, 1/s, and gamma, 1/s^3. */
real adaptive_composite_gain(const Adaptive *self);
real adaptive_tracking_gain(const Adaptive *self);

/* Signals [n, SIGNAL_COUNT] and residuals [n, 3] of the last second, the oldest first; at most RING_MAX. Returns n. */
int32_t adaptive_recent(const Adaptive *self, real *states, real *residuals);

/* [k, 3], what the map flies with where nothing was measured: theta of the law with a covariance, W of the gradient law. */
const real *adaptive_prior_layer(const Adaptive *self);

/* The same after a swap. */
const real *adaptive_prior_of(const Adaptive *self, const SwapPlan *plan);

/* A copy of everything that a swap replaces. */
void adaptive_learnt(const Adaptive *self, Learnt *out);

/* Fly these features and this W again; the bias takes up what is missing to nu at the present state. */
void adaptive_restore(Adaptive *self, const Learnt *learnt, const real nu[3]);

/* W [k, 3], a copy. */
void adaptive_W(const Adaptive *self, real *W);

/* Start with W [k, 3] of an earlier flight with the same features, as the trained last layer too. */
void adaptive_start_from(Adaptive *self, const real *W);

/* Whether these features, with this theta, are in use already: a swap to them would change nothing. */
bool adaptive_flies(const Adaptive *self, const ChannelFeatures *channel);

/* Start to prepare a swap to these features; false for the gradient law, whose plan needs no preparation. */
bool adaptive_prepare(const Adaptive *self, const ChannelFeatures *channel, PosteriorSwap *swap);

/* The plan of a swap that is prepared. Nothing else changes. */
void adaptive_planned(const Adaptive *self, PosteriorSwap *swap, SwapPlan *plan);

/* Plan a swap of the gradient law: `new_features` becomes the features, `plan` says what became of it. Nothing else
 * changes. */
void adaptive_plan(const Adaptive *self, const ChannelFeatures *channel, Features *new_features, SwapWorkspace *work,
                   SwapPlan *plan);

/* Carry out a plan that was not refused. */
void adaptive_commit(Adaptive *self, const Features *new_features, const SwapPlan *plan);

#endif
