#include "control/laws/adaptive.h"

#include <string.h>

#include "numerics/elementary.h"
#include "protocol/geometry.h"

/* AdaptiveAugmentation.__init__ */
bool adaptive_init(Adaptive *self, const AdaptiveConfig *config, const ChannelGains *gains) {
    if (config->law.kind != LAW_GRADIENT) {
        return false;
    }
    TrackingWeights PB;
    self->config = *config;
    tracking_weights(gains, config->error_weight, &PB);
    last_layer_init(&self->last_layer, &config->law.gradient, self->features.feature_count, &PB);
    recent_init(&self->recent, config->swap.ring_size);
    memset(self->signals, 0, sizeof self->signals);
    memset(self->signals_ahead, 0, sizeof self->signals_ahead);
    self->ticks = 0;
    vector_zero(self->Delta_hat);
    self->eps_1_squared = self->eps_2 = REAL(0.0);
    return true;
}

/* AdaptiveAugmentation._filter_residual: Delta_hat_dot = (r - Delta_hat) / T, exact for r constant over dt */
static void filter_residual(Adaptive *self, const real residual[3], real dt) {
    real share = REAL(1.0) - real_exp(-dt / self->config.law.gradient.residual_filter_s);
    for (int i = 0; i < 3; i++) {
        self->Delta_hat[i] = self->Delta_hat[i] + share * (residual[i] - self->Delta_hat[i]);
    }
}

/* AdaptiveAugmentation._report: eps_1: mean of norm(W'Phi(x) - Delta_hat); eps_3: norm(W'Phi(x_ahead) - W'Phi(x)) */
static void report(Adaptive *self, const real now[3], const real ahead[3], real dt, ChannelTelemetry *telemetry) {
    real misfit[3], difference[3];
    vector_subtract(now, self->Delta_hat, misfit);
    vector_subtract(ahead, now, difference);
    real share = real_min(dt / EPS_1_MEMORY_S, REAL(1.0));
    self->eps_1_squared += share * (vector_squared_length(misfit) - self->eps_1_squared);
    vector_copy(now, telemetry->adaptive_now);
    vector_copy(self->Delta_hat, telemetry->residual);
    telemetry->weight_norm = last_layer_weight_norm(&self->last_layer);
    telemetry->eps_1 = real_sqrt(self->eps_1_squared);
    telemetry->eps_2 = self->eps_2;
    telemetry->eps_3 = vector_length(difference);
}

/* AdaptiveAugmentation.step */
void adaptive_step(Adaptive *self, const ChannelState *channel, ChannelTelemetry *telemetry, real nu_ad[3]) {
    real z[INPUTS_MAX], Phi[FEATURES_MAX], Phi_ahead[FEATURES_MAX], now[3], ahead[3];
    memcpy(self->signals, channel->signals, sizeof self->signals);
    memcpy(self->signals_ahead, channel->signals_ahead, sizeof self->signals_ahead);
    features_select(&self->features, channel->signals, z);
    features_evaluate(&self->features, z, Phi);
    features_select(&self->features, channel->signals_ahead, z);
    features_evaluate(&self->features, z, Phi_ahead);
    if (channel->adapt) {
        filter_residual(self, channel->residual, channel->dt);
        last_layer_step(&self->last_layer, Phi, channel->model_error, self->Delta_hat, channel->dt);
        if (self->ticks % self->config.swap.ring_period_ticks == 0) {
            recent_push(&self->recent, channel->signals);
        }
        self->ticks++;
    }
    last_layer_output(&self->last_layer, Phi, now);
    last_layer_output(&self->last_layer, Phi_ahead, ahead);
    report(self, now, ahead, channel->dt, telemetry);
    vector_copy(ahead, nu_ad);
}

/* AdaptiveAugmentation.reset */
void adaptive_reset(Adaptive *self) {
    vector_zero(self->Delta_hat);
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

/* AdaptiveAugmentation.flies. The memory of the last layer is the theta that came with the features; the features that a
 * flight starts with have none, so that the memory is zero. */
bool adaptive_flies(const Adaptive *self, const ChannelFeatures *channel) {
    const Features *own = &self->features;
    return own->kind == ADAPTIVE_FEATURES_NETWORK &&
           same_network(&own->selection, &own->network, &channel->selection, &channel->network) &&
           alike(self->last_layer.memory, channel->last_layer, 3 * own->feature_count);
}

/* AdaptiveAugmentation.plan */
void adaptive_plan(const Adaptive *self, const ChannelFeatures *channel, Features *new_features, SwapWorkspace *work,
                   SwapPlan *plan) {
    features_init_network(new_features, &channel->selection, &channel->network);
    int32_t n = recent_states(&self->recent, self->signals, self->signals_ahead, work->states);
    plan_swap(&self->config.swap, &self->features, self->last_layer.W, new_features, channel->last_layer,
              self->config.law.gradient.weight_norm_max, n, work, plan);
}

/* AdaptiveAugmentation.commit */
void adaptive_commit(Adaptive *self, const Features *new_features, const SwapPlan *plan, const real *memory) {
    self->features = *new_features;
    last_layer_replace(&self->last_layer, plan->W, memory, new_features->feature_count);
    self->eps_2 = plan->jump;
}
