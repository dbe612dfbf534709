#include "control/laws/adaptive.h"

#include <string.h>

#include "numerics/elementary.h"
#include "protocol/geometry.h"

static bool has_covariance(const Adaptive *self) {
    return self->config.law.kind == LAW_KALMAN;
}

/* Whether the slope of W'Phi is bounded while W is learnt. */
static bool is_bounded(const Adaptive *self) {
    return has_covariance(self) && self->config.law.kalman.composite_gain > REAL(0.0);
}

/* AdaptiveAugmentation.reads_path */
bool adaptive_reads_path(const Adaptive *self) {
    return has_covariance(self);
}

/* AdaptiveConfig.slope_shares */
SlopeShares adaptive_slope_shares(const AdaptiveConfig *config) {
    const SlopeShares own = {.place = REAL(1.0), .motion = REAL(1.0), .turn = REAL(1.0)};
    return config->law.kind == LAW_KALMAN ? config->law.kalman.slope : own;
}

/* AdaptiveAugmentation._use, of the present features */
static void use_features(Adaptive *self) {
    if (is_bounded(self)) {
        int32_t ticks = self->slope_bound.ticks; /* a swap does not move the next check */
        slope_bound_init(&self->slope_bound, &self->features.selection, &self->slope_limits);
        self->slope_bound.ticks = ticks;
    }
}

/* AdaptiveAugmentation.__init__ */
void adaptive_init(Adaptive *self, const AdaptiveConfig *config, const ChannelGains *gains,
                   const SlopeLimits *slope_limits) {
    self->config = *config;
    self->slope_limits = *slope_limits;
    tracking_weights(gains, config->error_weight, &self->tracking_weights);
    if (has_covariance(self)) {
        kalman_layer_init(&self->kalman_layer, &config->law.kalman, self->features.feature_count,
                          &self->tracking_weights);
    } else {
        last_layer_init(&self->last_layer, &config->law.gradient, self->features.feature_count,
                        &self->tracking_weights);
    }
    self->slope_bound.ticks = 0;
    use_features(self);
    recent_init(&self->recent, config->swap.ring_size);
    memset(self->signals, 0, sizeof self->signals);
    self->ticks = 0;
    self->dt = REAL(0.0);
    vector_zero(self->Delta_hat);
    self->eps_1_squared = self->eps_2 = REAL(0.0);
}

/* AdaptiveAugmentation._filter_residual: Delta_hat_dot = (r - Delta_hat) / T, exact for r constant over dt */
static void filter_residual(Adaptive *self, const real residual[3], real dt) {
    const AdaptiveLaw *law = &self->config.law;
    real filter_s = has_covariance(self) ? law->kalman.residual_filter_s : law->gradient.residual_filter_s;
    real share = REAL(1.0) - real_exp(-dt / filter_s);
    for (int i = 0; i < 3; i++) {
        self->Delta_hat[i] = self->Delta_hat[i] + share * (residual[i] - self->Delta_hat[i]);
    }
}

/* AdaptiveAugmentation._report: eps_1: mean of norm(nu(x) - Delta_hat); eps_3: norm(nu_cmd - nu(x)) */
static void report(Adaptive *self, const real nu[3], const real nu_cmd[3], real dt, ChannelTelemetry *telemetry) {
    real misfit[3], difference[3];
    vector_subtract(nu, self->Delta_hat, misfit);
    vector_subtract(nu_cmd, nu, difference);
    real share = real_min(dt / EPS_1_MEMORY_S, REAL(1.0));
    self->eps_1_squared += share * (vector_squared_length(misfit) - self->eps_1_squared);
    vector_copy(nu, telemetry->adaptive_now);
    vector_copy(self->Delta_hat, telemetry->residual);
    telemetry->weight_norm = has_covariance(self) ? kalman_layer_weight_norm(&self->kalman_layer)
                                                  : last_layer_weight_norm(&self->last_layer);
    telemetry->eps_1 = real_sqrt(self->eps_1_squared);
    telemetry->eps_2 = self->eps_2;
    telemetry->eps_3 = vector_length(difference);
}

/* Phi [2, k] at the signals of the last tick; of a law that reads its map on the path [3, k]. */
static void features_of_tick(const Adaptive *self, real *Phi) {
    features_at(&self->features, self->signals, adaptive_reads_path(self) ? 3 : 2, Phi, self->features.feature_count);
}

/* LastLayer.estimate or KalmanLastLayer.estimate: nu and nu_cmd */
static void estimate(const Adaptive *self, const real *Phi, real nu[3], real nu_cmd[3]) {
    if (has_covariance(self)) {
        kalman_layer_estimate(&self->kalman_layer, Phi, nu, nu_cmd);
    } else {
        last_layer_output(&self->last_layer, Phi, nu);
        last_layer_output(&self->last_layer, Phi + self->features.feature_count, nu_cmd);
    }
}

/* LastLayer.learn or KalmanLastLayer.learn */
static void learn(Adaptive *self, const ChannelState *channel, const real *Phi, real nu[3], real nu_cmd[3]) {
    if (has_covariance(self)) {
        kalman_layer_step(&self->kalman_layer, Phi, channel->model_error, self->Delta_hat, channel->dt, nu, nu_cmd);
    } else {
        last_layer_step(&self->last_layer, Phi, channel->model_error, self->Delta_hat, channel->dt);
        estimate(self, Phi, nu, nu_cmd);
    }
}

/* AdaptiveAugmentation.step */
void adaptive_step(Adaptive *self, const ChannelState *channel, ChannelTelemetry *telemetry, real nu_ad[3]) {
    real Phi[3 * FEATURES_MAX], nu[3], nu_cmd[3];
    memcpy(self->signals, channel->signals, sizeof channel->signals);
    memcpy(self->signals + SIGNAL_COUNT, channel->signals_ahead, sizeof channel->signals_ahead);
    memcpy(self->signals + 2 * SIGNAL_COUNT, channel->signals_path, sizeof channel->signals_path);
    features_of_tick(self, Phi);
    if (channel->adapt) {
        filter_residual(self, channel->residual, channel->dt);
        if (is_bounded(self)) {
            slope_bound_step(&self->slope_bound, &self->features, self->signals, self->kalman_layer.theta,
                             &self->kalman_layer.state);
        }
        learn(self, channel, Phi, nu, nu_cmd);
        if (self->ticks % self->config.swap.ring_period_ticks == 0) {
            recent_push(&self->recent, channel->signals, self->Delta_hat);
        }
        self->ticks++;
    } else {
        estimate(self, Phi, nu, nu_cmd);
    }
    self->dt = channel->dt;
    report(self, nu, nu_cmd, channel->dt, telemetry);
    vector_copy(nu_cmd, nu_ad);
}

/* AdaptiveAugmentation.reset */
void adaptive_reset(Adaptive *self) {
    vector_zero(self->Delta_hat);
    if (has_covariance(self)) {
        kalman_layer_close_gap(&self->kalman_layer, NULL);
    }
}

/* AdaptiveAugmentation.learns */
bool adaptive_learns(const Adaptive *self) {
    return self->config.features == ADAPTIVE_FEATURES_NETWORK;
}

/* AdaptiveAugmentation.jump_max */
real adaptive_jump_max(const Adaptive *self) {
    return self->config.swap.jump_max;
}

/* AdaptiveAugmentation.last_layer.config.composite_gain */
real adaptive_composite_gain(const Adaptive *self) {
    const AdaptiveLaw *law = &self->config.law;
    return has_covariance(self) ? law->kalman.composite_gain : law->gradient.composite_gain;
}

/* AdaptiveAugmentation.last_layer.config.tracking_gain */
real adaptive_tracking_gain(const Adaptive *self) {
    const AdaptiveLaw *law = &self->config.law;
    return has_covariance(self) ? law->kalman.tracking_gain : law->gradient.tracking_gain;
}

/* AdaptiveAugmentation.recent */
int32_t adaptive_recent(const Adaptive *self, real *states, real *residuals) {
    return recent_in_order(&self->recent, states, residuals);
}

/* AdaptiveAugmentation.prior_layer */
const real *adaptive_prior_layer(const Adaptive *self) {
    return has_covariance(self) ? self->kalman_layer.theta : self->last_layer.W;
}

/* AdaptiveAugmentation.prior_of */
const real *adaptive_prior_of(const Adaptive *self, const SwapPlan *plan) {
    return has_covariance(self) ? plan->theta : plan->W;
}

/* AdaptiveAugmentation.learnt */
void adaptive_learnt(const Adaptive *self, Learnt *out) {
    size_t layer = (size_t)(3 * self->features.feature_count) * sizeof(real);
    features_copy(&out->features, &self->features);
    if (has_covariance(self)) {
        const KalmanState *state = &self->kalman_layer.state;
        memcpy(out->theta, self->kalman_layer.theta, layer);
        memcpy(out->W, state->X, (size_t)(3 * state->size) * sizeof(real));
        memcpy(out->S, state->S, (size_t)(state->size * state->size) * sizeof(covariance));
    } else {
        memcpy(out->theta, self->last_layer.memory, layer);
        memcpy(out->W, self->last_layer.W, layer);
    }
}

/* KalmanLastLayer.adopt or LastLayer.replace */
static void take_over(Adaptive *self, const real *theta, const real *W, const covariance *S) {
    int32_t k = self->features.feature_count;
    if (has_covariance(self)) {
        kalman_layer_adopt(&self->kalman_layer, theta, W, S, k);
    } else {
        last_layer_replace(&self->last_layer, W, theta, k);
    }
}

/* KalmanLastLayer.close_gap, with Phi of the last tick */
static void close_gap(Adaptive *self, const real *Phi) {
    if (has_covariance(self)) {
        kalman_layer_close_gap(&self->kalman_layer, Phi);
    }
}

/* AdaptiveAugmentation.restore */
void adaptive_restore(Adaptive *self, const Learnt *learnt, const real nu[3]) {
    real Phi[3 * FEATURES_MAX], W[STATES_MAX * 3], now[3], nu_cmd[3];
    features_copy(&self->features, &learnt->features);
    use_features(self);
    int32_t rows = self->features.feature_count + (has_covariance(self) ? 1 : 0);
    memcpy(W, learnt->W, (size_t)(3 * rows) * sizeof(real));
    take_over(self, learnt->theta, W, learnt->S);
    features_of_tick(self, Phi);
    estimate(self, Phi, now, nu_cmd);
    for (int axis = 0; axis < 3; axis++) {
        W[3 * (rows - 1) + axis] += nu[axis] - now[axis];
    }
    take_over(self, learnt->theta, W, learnt->S);
    close_gap(self, Phi);
    self->eps_2 = REAL(0.0);
}

/* CascadedController.last_layers, of one channel */
void adaptive_W(const Adaptive *self, real *W) {
    if (has_covariance(self)) {
        kalman_layer_W(&self->kalman_layer, W);
    } else {
        memcpy(W, self->last_layer.W, (size_t)(3 * self->features.feature_count) * sizeof(real));
    }
}

/* CascadedController.start_from, of one channel */
void adaptive_start_from(Adaptive *self, const real *W) {
    if (has_covariance(self)) {
        kalman_layer_replace(&self->kalman_layer, W, W, self->features.feature_count);
    } else {
        last_layer_replace(&self->last_layer, W, W, self->features.feature_count);
    }
}

static bool alike(const real *a, const real *b, int32_t count) {
    for (int i = 0; i < count; i++) {
        if (a[i] != b[i]) {
            return false;
        }
    }
    return true;
}

/* ChannelFeatures.same_as, but for theta_n */
static bool same_network(const FeatureSelection *a, const Network *A, const FeatureSelection *b, const Network *B) {
    if (a->count != b->count || A->layers != B->layers) {
        return false;
    }
    for (int i = 0; i < a->count; i++) {
        if (a->index[i] != b->index[i]) {
            return false;
        }
    }
    int32_t inputs = a->count, parameters = 0;
    for (int i = 0; i < A->layers; i++) {
        if (A->width[i] != B->width[i]) {
            return false;
        }
        parameters += A->width[i] * (inputs + 1);
        inputs = A->width[i];
    }
    return alike(a->offset, b->offset, a->count) && alike(a->scale, b->scale, a->count) &&
           alike(A->parameters, B->parameters, parameters);
}

/* AdaptiveAugmentation.flies */
bool adaptive_flies(const Adaptive *self, const ChannelFeatures *channel) {
    const Features *own = &self->features;
    return own->kind == ADAPTIVE_FEATURES_NETWORK &&
           same_network(&own->selection, &own->network, &channel->selection, &channel->network) &&
           alike(own->last_layer, channel->last_layer, 3 * own->feature_count);
}

/* AdaptiveAugmentation.prepare */
bool adaptive_prepare(const Adaptive *self, const ChannelFeatures *channel, PosteriorSwap *swap) {
    if (!has_covariance(self)) {
        return false;
    }
    real between = (real)self->config.swap.ring_period_ticks * self->dt;
    posterior_swap_begin(swap, &self->kalman_layer, channel, &self->recent, self->signals, self->dt, between);
    return true;
}

/* AdaptiveAugmentation.planned */
void adaptive_planned(const Adaptive *self, PosteriorSwap *swap, SwapPlan *plan) {
    const SwapConfig *config = &self->config.swap;
    int64_t since = self->ticks - 1 - (swap->seen - 1) * config->ring_period_ticks;
    posterior_swap_plan(swap, config, &self->kalman_layer, &self->features, self->signals, (real)since * self->dt,
                        plan);
}

/* AdaptiveAugmentation.plan, of the gradient law */
void adaptive_plan(const Adaptive *self, const ChannelFeatures *channel, Features *new_features, SwapWorkspace *work,
                   SwapPlan *plan) {
    features_init_network(new_features, &channel->selection, &channel->network);
    memcpy(new_features->last_layer, channel->last_layer, sizeof new_features->last_layer);
    int32_t n = recent_states(&self->recent, self->signals, self->signals + SIGNAL_COUNT, work->states);
    plan_swap(&self->config.swap, &self->features, self->last_layer.W, new_features, channel->last_layer,
              self->config.law.gradient.weight_norm_max, n, work, plan);
}

/* AdaptiveAugmentation.commit */
void adaptive_commit(Adaptive *self, const Features *new_features, const SwapPlan *plan) {
    real Phi[3 * FEATURES_MAX];
    features_copy(&self->features, new_features);
    use_features(self);
    take_over(self, plan->theta, has_covariance(self) ? plan->posterior.X : plan->W, plan->posterior.S);
    features_of_tick(self, Phi);
    close_gap(self, Phi);
    self->eps_2 = plan->jump;
}
