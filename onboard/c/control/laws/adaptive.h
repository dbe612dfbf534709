/* MRAC and DMRAC: nu_ad = W' Phi(x, c), with the gradient law of the last layer. The twin of
 * onboard/control/laws/adaptive.py. The law with a covariance (`law.kind: kalman`) is not written in C yet. */
#ifndef DMRAC_ADAPTIVE_H
#define DMRAC_ADAPTIVE_H

#include "control/feature_swap.h"
#include "control/features.h"
#include "control/laws/last_layer.h"
#include "control/laws/law.h"

/* One channel's features, last layer, and swap. */
typedef struct {
    AdaptiveConfig config;
    Features features;
    LastLayer last_layer;
    RecentStates recent;
    real signals[SIGNAL_COUNT];
    real signals_ahead[SIGNAL_COUNT];
    int64_t ticks;
    real Delta_hat[3];
    real eps_1_squared;
    real eps_2;
} Adaptive;

/* The features of the start are set with features_init_...(&self->features) before. Returns false for another law than the
 * gradient one; `self` must not be used then. */
bool adaptive_init(Adaptive *self, const AdaptiveConfig *config, const ChannelGains *gains);

/* Update W with Phi(x); nu_ad = W'Phi(x_ahead). */
void adaptive_step(Adaptive *self, const ChannelState *channel, ChannelTelemetry *telemetry, real nu_ad[3]);

/* Reset the filter. W and the features stay. */
void adaptive_reset(Adaptive *self);

/* Whether these features, with this theta, are in use already: a swap to them would change nothing. */
bool adaptive_flies(const Adaptive *self, const ChannelFeatures *channel);

/* Plan a swap to these features: `new_features` becomes them, `plan` says what became of it. Nothing else changes. */
void adaptive_plan(const Adaptive *self, const ChannelFeatures *channel, Features *new_features, SwapWorkspace *work,
                   SwapPlan *plan);

/* Carry out a plan that was not refused. memory: theta_n [k, 3]. */
void adaptive_commit(Adaptive *self, const Features *new_features, const SwapPlan *plan, const real *memory);

#endif
