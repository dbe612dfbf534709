/* The last-layer adaptive law: updates W at 200 Hz so that nu_ad = W' Phi follows the disturbance Delta. The twin of
 * onboard/control/laws/last_layer.py, which explains it.
 *
 *     W_dot = Proj(W, -Gamma Phi (gamma e' P B + lambda (W'Phi - Delta_hat)') / m^2) - sigma L (W - theta_n)
 *     m^2 = eps + Phi' Gamma Phi,  Gamma = diag(1, ..., 1, kappa),  L = diag(1, ..., 1, 0)
 */
#ifndef DMRAC_LAST_LAYER_H
#define DMRAC_LAST_LAYER_H

#include "control/features.h"
#include "generated/config.h"
#include "generated/constants.h"

/* PB of one channel, and the gains of its reference model. Its axes are decoupled, so of each column only two numbers
 * differ from zero. */
typedef struct {
    real e_1[3]; /* weight of the error in the axis' own column */
    real e_2[3]; /* weight of its rate */
    real K_1[3];
    real K_2[3];
} TrackingWeights;

/* PB from the Lyapunov equation A_rm' P + P A_rm + Q = 0 of the channel's reference model, Q = diag(error_weight), each
 * axis scaled so that gamma means the same whatever Q. */
void tracking_weights(const ChannelGains *gains, const real error_weight[2], TrackingWeights *out);

typedef struct {
    AdaptationConfig config;
    TrackingWeights PB;
    real rate_weight; /* p, the largest weight of e_2 in PB */
    real bound2;
    real safe_bound2;
    int32_t feature_count;
    real W[FEATURES_MAX * 3];      /* [k, 3] */
    real memory[FEATURES_MAX * 3]; /* theta_n, the trained last layer, towards which W leaks */
    real norm2;
} LastLayer;

/* W and theta_n are zero. */
void last_layer_init(LastLayer *self, const AdaptationConfig *config, int32_t feature_count, const TrackingWeights *PB);

/* Takes over W [k, 3] and theta_n [k, 3] that belong to new features; W is clipped into the ball. */
void last_layer_replace(LastLayer *self, const real *W, const real *memory, int32_t feature_count);

/* One step of the law. Phi [k] at the present state; e = x_rm - x; Delta_hat the filtered residual, units of u. */
void last_layer_step(LastLayer *self, const real *Phi, const real e[6], const real Delta_hat[3], real dt);

/* nu_ad = W'Phi. */
void last_layer_output(const LastLayer *self, const real *Phi, real nu_ad[3]);

/* Frobenius norm of W, units of u. */
real last_layer_weight_norm(const LastLayer *self);

#endif
