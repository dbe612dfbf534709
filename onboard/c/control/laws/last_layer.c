#include "control/laws/last_layer.h"

#include <string.h>

#include "control/reference_model.h"
#include "numerics/elementary.h"
#include "numerics/small_matrix.h"

/* lyapunov_p and tracking_weights. For an axis with A = [0, 1; -K_1, -K_2] and Q = diag(q_1, q_2):
 * P_12 = q_1 / (2 K_1),  P_22 = (q_2 + 2 P_12) / (2 K_2) */
void tracking_weights(const ChannelGains *gains, const real error_weight[2], TrackingWeights *out) {
    gains_stiffness(gains, out->K_1);
    gains_rate_gain(gains, out->K_2);
    for (int axis = 0; axis < 3; axis++) {
        real P_12 = error_weight[0] / (REAL(2.0) * out->K_1[axis]);
        real P_22 = (error_weight[1] + REAL(2.0) * P_12) / (REAL(2.0) * out->K_2[axis]);
        real ratio = gains->natural_frequency_rad_s[axis] / gains->natural_frequency_rad_s[0];
        real scale = ratio * ratio * ratio / P_12;
        out->e_1[axis] = P_12 * scale;
        out->e_2[axis] = P_22 * scale;
    }
}

/* LastLayer.__init__ */
void last_layer_init(LastLayer *self, const AdaptationConfig *config, int32_t feature_count,
                     const TrackingWeights *PB) {
    memset(self, 0, sizeof *self);
    self->config = *config;
    self->bound2 = config->weight_norm_max * config->weight_norm_max;
    self->safe_bound2 = self->bound2 * (REAL(1.0) + PROJECTION_MARGIN);
    self->PB = *PB;
    self->rate_weight = real_max(real_max(PB->e_2[0], PB->e_2[1]), PB->e_2[2]);
    self->feature_count = feature_count;
}

/* LastLayer._keep_in_ball */
static void keep_in_ball(LastLayer *self) {
    int count = 3 * self->feature_count;
    self->norm2 = dot(self->W, self->W, count);
    if (self->norm2 > self->safe_bound2) {
        real share = real_sqrt(self->safe_bound2 / self->norm2);
        for (int i = 0; i < count; i++) {
            self->W[i] *= share;
        }
        self->norm2 = self->safe_bound2;
    }
}

/* LastLayer.replace */
void last_layer_replace(LastLayer *self, const real *W, const real *memory, int32_t feature_count) {
    self->feature_count = feature_count;
    for (int i = 0; i < 3 * feature_count; i++) {
        self->W[i] = W[i];
        self->memory[i] = memory[i];
    }
    keep_in_ball(self);
}

/* LastLayer._gain_along: Phi' Gamma Phi, where Gamma is 1 but for the last feature */
static real gain_along(const LastLayer *self, const real *Phi) {
    real last = Phi[self->feature_count - 1];
    return dot(Phi, Phi, self->feature_count) + (self->config.bias_weight - REAL(1.0)) * last * last;
}

/* The change of W, [k, 3], is Gamma Phi d': element (i, axis) is gamma_i Phi_i d_axis. */
static real weight_of(const LastLayer *self, int i) {
    return i == self->feature_count - 1 ? self->config.bias_weight : REAL(1.0);
}

/* projected_rate: what the smooth projection takes from the change: `change` - Gamma W share */
static real projection_share(const LastLayer *self, const real *Phi, const real d[3]) {
    real limit = self->config.weight_norm_max * self->config.weight_norm_max;
    real f = (dot(self->W, self->W, 3 * self->feature_count) - limit) / (PROJECTION_MARGIN * limit);
    if (f <= REAL(0.0)) {
        return REAL(0.0);
    }
    real outward = REAL(0.0), inner = REAL(0.0);
    for (int i = 0; i < self->feature_count; i++) {
        const real *W = self->W + 3 * i;
        real gamma = weight_of(self, i);
        outward += gamma * Phi[i] * (W[0] * d[0] + W[1] * d[1] + W[2] * d[2]);
        inner += gamma * (W[0] * W[0] + W[1] * W[1] + W[2] * W[2]);
    }
    return outward <= REAL(0.0) ? REAL(0.0) : real_min(f, REAL(1.0)) * outward / inner;
}

/* W += change - Gamma W share */
static void apply_change(LastLayer *self, const real *Phi, const real d[3], real share) {
    for (int i = 0; i < self->feature_count; i++) {
        real gamma = weight_of(self, i);
        real *W = self->W + 3 * i;
        for (int axis = 0; axis < 3; axis++) {
            W[axis] += gamma * (Phi[i] * d[axis]) - gamma * W[axis] * share;
        }
    }
}

/* The implicit leak towards theta_n; the bias has none. */
static void leak(LastLayer *self, real dt) {
    real share = self->config.leak * dt;
    share = share / (REAL(1.0) + share);
    for (int i = 0; i < 3 * (self->feature_count - 1); i++) {
        self->W[i] += share * (self->memory[i] - self->W[i]);
    }
}

/* LastLayer.step */
void last_layer_step(LastLayer *self, const real *Phi, const real e[6], const real Delta_hat[3], real dt) {
    const AdaptationConfig *config = &self->config;
    real s = gain_along(self, Phi);
    real m2 = config->normalisation_floor + s;
    real gamma = config->tracking_gain, lambda = config->composite_gain;
    /* Tracking term, implicit in its own effect on e_2 one step later. */
    real tracking = gamma / (REAL(1.0) + gamma * self->rate_weight * dt * dt) / m2;
    real d[3];
    for (int axis = 0; axis < 3; axis++) {
        d[axis] = -tracking * (e[axis] * self->PB.e_1[axis] + e[3 + axis] * self->PB.e_2[axis]);
    }
    if (lambda > REAL(0.0)) {
        /* Composite term, implicit in its rank-one part: W+ = W - a Gamma Phi (W+'Phi - Delta_hat)'.
         * The tracking term acts first; it changes W'Phi by s d dt. */
        real a = lambda * dt / m2;
        real composite = lambda / m2 / (REAL(1.0) + a * s);
        real nu[3];
        last_layer_output(self, Phi, nu);
        for (int axis = 0; axis < 3; axis++) {
            d[axis] -= composite * (nu[axis] + s * dt * d[axis] - Delta_hat[axis]);
        }
    }
    if (!(s < SQUARE_MAX && d[0] * d[0] + d[1] * d[1] + d[2] * d[2] < SQUARE_MAX)) { /* NaN fails too */
        return;
    }
    for (int axis = 0; axis < 3; axis++) {
        d[axis] *= dt;
    }
    apply_change(self, Phi, d, self->norm2 > self->bound2 ? projection_share(self, Phi, d) : REAL(0.0));
    if (config->leak > REAL(0.0)) {
        leak(self, dt);
    }
    keep_in_ball(self);
}

/* W.T @ Phi */
void last_layer_output(const LastLayer *self, const real *Phi, real nu_ad[3]) {
    nu_ad[0] = nu_ad[1] = nu_ad[2] = REAL(0.0);
    for (int i = 0; i < self->feature_count; i++) {
        for (int axis = 0; axis < 3; axis++) {
            nu_ad[axis] += self->W[3 * i + axis] * Phi[i];
        }
    }
}

/* LastLayer.weight_norm */
real last_layer_weight_norm(const LastLayer *self) {
    return real_sqrt(self->norm2);
}
