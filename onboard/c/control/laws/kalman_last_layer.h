/* The last-layer law with a covariance: W and a fast bias b are estimated together by a Kalman filter. The twin of
 * onboard/control/laws/kalman_last_layer.py, which explains it. X = [W - theta; b].
 *
 *     nu     = W'Phi + b                                                   at the present state
 *     nu_cmd = W'Phi_p + g (theta'Phi_a + a (W - theta)'Phi_a - W'Phi_p) + b + gap      a: on the path, t_ahead from now
 *     gap: what the map says at x, W'Phi - W'Phi_p, behind a filter (path_gap.h)    p: on the path, now
 *     [W; b] += S phi (r - nu - t e'PB)' / (R_t + s),    S -= S phi phi'S / (R_t + s),    R_t = max(R, s / (lambda dt))
 *
 * `Phi` of a tick is [3, k]: the features at the present state, on the path ahead, and on the path now. */
#ifndef DMRAC_KALMAN_LAST_LAYER_H
#define DMRAC_KALMAN_LAST_LAYER_H

#include "control/laws/forecast_skill.h"
#include "control/laws/kalman_state.h"
#include "control/laws/last_layer.h"
#include "control/laws/path_gap.h"

typedef struct {
    KalmanConfig config;
    TrackingWeights PB;
    real rate_weight; /* the largest weight of e_2 in PB */
    real noise_variance;
    real prior_variance; /* p^2 */
    real radius2;
    int32_t feature_count;        /* k */
    real theta[FEATURES_MAX * 3]; /* [k, 3], the trained last layer */
    real theta_norm2;
    Factor columns[3]; /* of theta */
    KalmanState state; /* n = k + 1, the bias last */
    real X_norm2;
    PathGap gap;
    ForecastSkill skill;
    real work[STATES_MAX * STATES_MAX];  /* of the projection; it keeps nothing between two steps */
    real dense[STATES_MAX * STATES_MAX]; /* the same: S in `real`, where it is in whole numbers */
} KalmanLastLayer;

/* theta and X are zero, S = S0. */
void kalman_layer_init(KalmanLastLayer *self, const KalmanConfig *config, int32_t feature_count,
                       const TrackingWeights *PB);

/* W [k, 3]. */
void kalman_layer_W(const KalmanLastLayer *self, real *W);

/* Frobenius norm of W, units of u. */
real kalman_layer_weight_norm(const KalmanLastLayer *self);

/* Variance of what R makes of Delta_hat: white noise behind the filter. */
real kalman_layer_residual_variance(const KalmanLastLayer *self, real dt);

/* Take over W [k, 3] and theta [k, 3] that belong to new features, with S = S0 and b = 0. */
void kalman_layer_replace(KalmanLastLayer *self, const real *W, const real *theta, int32_t feature_count);

/* Take over theta [k, 3], X [k + 1, 3] and S [k + 1, k + 1] that belong to new features. None of them may lie within
 * `self`. */
void kalman_layer_adopt(KalmanLastLayer *self, const real *theta, const real *X, const covariance *S,
                        int32_t feature_count);

/* nu and nu_cmd with Phi of a tick. */
void kalman_layer_estimate(const KalmanLastLayer *self, const real *Phi, real nu[3], real nu_cmd[3]);

/* nu [3, n] at the features Phi [k, n]. The last three are those of a tick: nu_cmd is the last but one. */
void kalman_layer_at(const KalmanLastLayer *self, const real *Phi, int32_t n, real *nu);

/* Leave of the change ahead in nu [3, n], as kalman_evaluate gives it, the share that the skill allows. */
void kalman_layer_look_ahead(const KalmanLastLayer *self, int32_t n, real *nu);

/* The deviation from the path counts in full: after a swap. Phi of a tick; NULL: there is none. A law that is off takes up
 * no misfit, so there the map is read on the path alone. */
void kalman_layer_close_gap(KalmanLastLayer *self, const real *Phi);

/* One tick: predict, correct, project; nu and nu_cmd with Phi of the tick. e = x_rm - x; the residual is Delta_hat,
 * units of u. */
void kalman_layer_step(KalmanLastLayer *self, const real *Phi, const real e[6], const real residual[3], real dt,
                       real nu[3], real nu_cmd[3]);

/* Start a filter of k features from X = 0 and S = S0: W reverts at `prior_rate`, b at the rate of the config. */
void kalman_start(const KalmanConfig *config, real prior_rate, int32_t feature_count, KalmanState *out);

/* nu [3, n] at the features Phi [k, n]; the last three are those of a tick: the second of them, ahead, fades. */
void kalman_evaluate(const KalmanConfig *config, const real *theta, const KalmanState *state, const real *Phi,
                     int32_t n, real *nu);

/* a, from the confidence at the present state and at the one ahead. */
real fade(real here, real ahead);

/* Project X [n, 3] onto the ball norm(X) <= radius in the metric of S^-1: (I + mu S)^-1 X. `work`: n^2 numbers. */
void project(real *X, const real *S, int32_t n, real radius, real *work);

#endif
