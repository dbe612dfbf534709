#include "control/laws/kalman_last_layer.h"

#include <string.h>

#include "numerics/elementary.h"
#include "numerics/small_matrix.h"
#include "protocol/geometry.h"

/* KalmanLastLayer.__init__ */
void kalman_layer_init(KalmanLastLayer *self, const KalmanConfig *config, int32_t feature_count,
                       const TrackingWeights *PB) {
    memset(self, 0, sizeof *self);
    self->config = *config;
    self->PB = *PB;
    self->rate_weight = real_max(real_max(PB->e_2[0], PB->e_2[1]), PB->e_2[2]);
    self->noise_variance = config->noise * config->noise;
    self->prior_variance = config->prior * config->prior;
    self->radius2 = config->weight_norm_max * config->weight_norm_max;
    self->feature_count = feature_count;
    if (!config->skill || config->composite_gain == REAL(0.0)) {
        for (int axis = 0; axis < 3; axis++) {
            self->skill.shares[axis] = REAL(1.0);
        }
    }
    kalman_start(config, config->prior_rate, feature_count, &self->state);
}

/* prior_variance, and the rates of KalmanLastLayer._start */
void kalman_start(const KalmanConfig *config, real prior_rate, int32_t feature_count, KalmanState *out) {
    real variance[STATES_MAX], rates[STATES_MAX];
    for (int i = 0; i < feature_count; i++) {
        variance[i] = config->prior * config->prior;
        rates[i] = prior_rate;
    }
    variance[feature_count] = config->fast_bias * config->fast_bias;
    rates[feature_count] = config->fast_bias_rate;
    kalman_state_init(out, variance, rates, feature_count + 1);
}

/* KalmanLastLayer._start */
static void start(KalmanLastLayer *self, const real *theta, int32_t feature_count) {
    int count = 3 * feature_count;
    self->feature_count = feature_count;
    memcpy(self->theta, theta, (size_t)count * sizeof(real));
    self->theta_norm2 = dot(theta, theta, count);
    factors_take(self->columns, theta, feature_count);
    self->X_norm2 = REAL(0.0);
    gap_close(&self->gap, NULL);
    skill_restart(&self->skill);
    kalman_start(&self->config, self->config.prior_rate, feature_count, &self->state);
}

/* KalmanLastLayer.W */
void kalman_layer_W(const KalmanLastLayer *self, real *W) {
    for (int i = 0; i < 3 * self->feature_count; i++) {
        W[i] = self->theta[i] + self->state.X[i];
    }
}

/* KalmanLastLayer.weight_norm: norm(theta + X)^2 without the row of b */
real kalman_layer_weight_norm(const KalmanLastLayer *self) {
    int k = self->feature_count;
    real cross = REAL(0.0), bias2 = vector_squared_length(self->state.X + 3 * k);
    Factor X[3];
    factors_take(X, self->state.X, k);
    for (int axis = 0; axis < 3; axis++) {
        cross += REAL(2.0) * factor_dot(self->columns + axis, X + axis, k);
    }
    return real_sqrt(real_max(self->theta_norm2 + cross + self->X_norm2 - bias2, REAL(0.0)));
}

/* KalmanLastLayer.residual_variance */
real kalman_layer_residual_variance(const KalmanLastLayer *self, real dt) {
    return self->noise_variance * dt / (REAL(2.0) * self->config.residual_filter_s);
}

static real squares_of_X(const KalmanLastLayer *self) {
    Factor X[3];
    real sum = REAL(0.0);
    factors_take(X, self->state.X, self->state.size);
    for (int axis = 0; axis < 3; axis++) {
        sum += factor_dot(X + axis, X + axis, self->state.size);
    }
    return sum;
}

/* KalmanLastLayer._keep_in_ball: what rounding leaves outside is scaled */
static void keep_in_ball(KalmanLastLayer *self) {
    KalmanState *state = &self->state;
    if (squares_of_X(self) > self->radius2) { /* NaN is not */
        const real *S = kalman_state_dense(state, self->dense);
        project(state->X, S, state->size, self->config.weight_norm_max, self->work);
    }
    self->X_norm2 = squares_of_X(self);
    if (self->X_norm2 > self->radius2) {
        real share = real_sqrt(self->radius2 / self->X_norm2);
        for (int i = 0; i < 3 * state->size; i++) {
            state->X[i] *= share;
        }
        self->X_norm2 = self->radius2;
    }
}

/* KalmanLastLayer.replace */
void kalman_layer_replace(KalmanLastLayer *self, const real *W, const real *theta, int32_t feature_count) {
    start(self, theta, feature_count);
    for (int i = 0; i < 3 * feature_count; i++) {
        self->state.X[i] = W[i] - theta[i];
    }
    keep_in_ball(self);
}

/* KalmanLastLayer.adopt */
void kalman_layer_adopt(KalmanLastLayer *self, const real *theta, const real *X, const covariance *S,
                        int32_t feature_count) {
    int n = feature_count + 1;
    start(self, theta, feature_count);
    memcpy(self->state.X, X, (size_t)(3 * n) * sizeof(real));
    memcpy(self->state.S, S, (size_t)(n * n) * sizeof(covariance));
    keep_in_ball(self);
}

/* fade */
real fade(real here, real ahead) {
    return ahead < here && here > REAL(0.0) ? real_max(ahead, REAL(0.0)) / here : REAL(1.0);
}

/* confidence: c = 1 - Phi'S Phi / Phi'S0 Phi; the numbers of Phi are `stride` apart */
static real confidence(const KalmanState *state, const real *Phi, int32_t stride) {
    int k = state->size - 1;
    real unknown = REAL(0.0), prior = REAL(0.0), column[FEATURES_MAX], g[STATES_MAX];
    for (int i = 0; i < k; i++) {
        column[i] = Phi[i * stride];
    }
    kalman_state_product(state, column, k, REAL(1.0), g);
    for (int i = 0; i < k; i++) {
        unknown += column[i] * g[i];
        prior += state->prior_variance[i] * column[i] * column[i];
    }
    return REAL(1.0) - unknown / prior;
}

/* nu of evaluate, of one column: theta'Phi + a X'Phi + b; the numbers of Phi are `stride` apart */
static void nu_of(const real *theta, const KalmanState *state, const real *Phi, int32_t stride, real a, real nu[3]) {
    int k = state->size - 1;
    real of_X[3];
    Factor columns[3], of_Phi;
    factor_take(&of_Phi, Phi, k, stride);
    factors_take(columns, theta, k);
    factors_times(columns, &of_Phi, k, nu);
    factors_take(columns, state->X, k);
    factors_times(columns, &of_Phi, k, of_X);
    for (int axis = 0; axis < 3; axis++) {
        nu[axis] = nu[axis] + a * of_X[axis] + state->X[3 * k + axis];
    }
}

/* KalmanLastLayer.estimate */
void kalman_layer_estimate(const KalmanLastLayer *self, const real *Phi, real nu[3], real nu_cmd[3]) {
    const real *Phi_ahead = Phi + self->feature_count, *Phi_path = Phi_ahead + self->feature_count;
    real a = REAL(1.0), ahead[3], on_path[3];
    if (self->config.confidence) {
        a = fade(confidence(&self->state, Phi, 1), confidence(&self->state, Phi_ahead, 1));
    }
    nu_of(self->theta, &self->state, Phi, 1, REAL(1.0), nu);
    nu_of(self->theta, &self->state, Phi_ahead, 1, a, ahead);
    nu_of(self->theta, &self->state, Phi_path, 1, REAL(1.0), on_path);
    skill_apply(&self->skill, on_path, ahead, nu_cmd);
    vector_add(nu_cmd, self->gap.values, nu_cmd);
}

/* evaluate */
void kalman_evaluate(const KalmanConfig *config, const real *theta, const KalmanState *state, const real *Phi,
                     int32_t n, real *nu) {
    real a = REAL(1.0), one[3];
    if (config->confidence) {
        a = fade(confidence(state, Phi + n - 3, n), confidence(state, Phi + n - 2, n));
    }
    for (int i = 0; i < n; i++) {
        nu_of(theta, state, Phi + i, n, i == n - 2 ? a : REAL(1.0), one);
        for (int axis = 0; axis < 3; axis++) {
            nu[axis * n + i] = one[axis];
        }
    }
}

/* KalmanLastLayer.at */
void kalman_layer_at(const KalmanLastLayer *self, const real *Phi, int32_t n, real *nu) {
    kalman_evaluate(&self->config, self->theta, &self->state, Phi, n, nu);
    kalman_layer_look_ahead(self, n, nu);
    for (int axis = 0; axis < 3; axis++) {
        nu[axis * n + n - 2] += self->gap.values[axis];
    }
}

/* KalmanLastLayer.look_ahead */
void kalman_layer_look_ahead(const KalmanLastLayer *self, int32_t n, real *nu) {
    for (int axis = 0; axis < 3; axis++) {
        real *row = nu + axis * n;
        row[n - 2] = row[n - 1] + self->skill.shares[axis] * (row[n - 2] - row[n - 1]);
    }
}

/* KalmanLastLayer.close_gap */
void kalman_layer_close_gap(KalmanLastLayer *self, const real *Phi) {
    gap_close(&self->gap, NULL);
    if (Phi != NULL && self->config.composite_gain > REAL(0.0)) {
        real here[3], path[3], deviation[3];
        nu_of(self->theta, &self->state, Phi, 1, REAL(1.0), here);
        nu_of(self->theta, &self->state, Phi + 2 * self->feature_count, 1, REAL(1.0), path);
        vector_subtract(here, path, deviation);
        gap_close(&self->gap, deviation);
    }
}

/* project */
void project(real *X, const real *S, int32_t n, real radius, real *work) {
    real Y[STATES_MAX * 3];
    if (dot(X, X, 3 * n) > radius * radius) { /* NaN is not */
        multiplier(S, X, n, 3, radius, Y, work);
        memcpy(X, Y, (size_t)(3 * n) * sizeof(real));
    }
}

/* What a step knows of one column. */
typedef struct {
    Factor Phi;
    real g[STATES_MAX]; /* S [Phi; 0] */
    Factor of_g;
    real form; /* Phi'S Phi */
} Along;

static void look_along(const KalmanLastLayer *self, const real *Phi, Along *out) {
    int k = self->feature_count;
    factor_take(&out->Phi, Phi, k, 1);
    kalman_state_product(&self->state, Phi, k, REAL(1.0), out->g);
    factor_take(&out->of_g, out->g, k, 1);
    out->form = factor_dot(&out->Phi, &out->of_g, k);
}

/* KalmanLastLayer._tracking: factor of e'PB in the innovation, implicit in the effect of the tracking term on e_2 one tick
 * later */
static real tracking(const KalmanLastLayer *self, real share, real dt) {
    real t = self->config.tracking_gain / self->config.composite_gain;
    return t / (REAL(1.0) + share * t * self->rate_weight * dt);
}

/* a after the correction, from forms before it: `of_here` and `of_ahead` are what it changed along each column */
static real faded(const KalmanLastLayer *self, const Along *h, const Along *a, real of_here, real of_ahead, real v) {
    int k = self->feature_count;
    real prior_here = self->prior_variance * factor_dot(&h->Phi, &h->Phi, k);
    real prior_ahead = self->prior_variance * factor_dot(&a->Phi, &a->Phi, k);
    return fade(REAL(1.0) - (h->form - of_here * of_here * v) / prior_here,
                REAL(1.0) - (a->form - of_ahead * of_ahead * v) / prior_ahead);
}

/* r - nu - t e'PB, with nu before the correction */
static void innovation_of(const KalmanLastLayer *self, const real map_here[3], const real e[6], const real residual[3],
                          real t, real d[3]) {
    const real *b = self->state.X + 3 * self->feature_count;
    for (int axis = 0; axis < 3; axis++) {
        real ePB = e[axis] * self->PB.e_1[axis] + e[3 + axis] * self->PB.e_2[axis];
        d[axis] = residual[axis] - map_here[axis] - b[axis] - t * ePB;
    }
}

/* X and S with phi = [Phi; 1]; false if X had to be projected */
static bool correct(KalmanLastLayer *self, const Along *here, const real *S_bias, const real d[3], real v) {
    KalmanState *state = &self->state;
    int n = state->size;
    real g[STATES_MAX];
    for (int i = 0; i < n; i++) {
        g[i] = here->g[i] + S_bias[i];
    }
    kalman_state_correct(state, g, d, v);
    self->X_norm2 = squares_of_X(self);
    if (self->X_norm2 > self->radius2) {
        keep_in_ball(self);
        return false;
    }
    return true;
}

/* W'Phi = theta'Phi + X'Phi */
static void map_of(const KalmanLastLayer *self, const Factor X[3], const Factor *Phi, real out[3]) {
    real of_X[3];
    factors_times(self->columns, Phi, self->feature_count, out);
    factors_times(X, Phi, self->feature_count, of_X);
    vector_add(out, of_X, out);
}

/* KalmanLastLayer.step */
void kalman_layer_step(KalmanLastLayer *self, const real *Phi, const real e[6], const real residual[3], real dt,
                       real nu[3], real nu_cmd[3]) {
    KalmanState *state = &self->state;
    int k = self->feature_count;
    real lambda = self->config.composite_gain;
    if (lambda == REAL(0.0)) {
        kalman_layer_estimate(self, Phi, nu, nu_cmd);
        return;
    }
    Along h, a; /* here, ahead */
    Factor path, of_bias_column, X[3];
    real map_here[3], on_path[3], theta_ahead[3], map_ahead[3], S_bias[STATES_MAX];
    kalman_state_predict(state, dt);
    look_along(self, Phi, &h);
    look_along(self, Phi + k, &a);
    factor_take(&path, Phi + 2 * k, k, 1);
    factors_take(X, state->X, k);
    map_of(self, X, &h.Phi, map_here);
    map_of(self, X, &path, on_path);
    factors_times(self->columns, &a.Phi, k, theta_ahead);
    factors_times(X, &a.Phi, k, map_ahead);
    /* Quadratic forms of S along the bias (b), here (h), ahead (a) and on the path now (p). */
    real bh = h.g[k], ah = factor_dot(&a.Phi, &h.of_g, k), ph = factor_dot(&path, &h.of_g, k), ba = a.g[k];
    kalman_state_column(state, k, S_bias);
    factor_take(&of_bias_column, S_bias, k, 1);
    real bp = factor_dot(&of_bias_column, &path, k), bb = S_bias[k];
    real s = h.form + REAL(2.0) * bh + bb;
    real v = real_max(self->noise_variance, s / (lambda * dt)) + s;
    real d[3], b[3], deviation[3], t = tracking(self, s / v, dt);
    innovation_of(self, map_here, e, residual, t, d);
    vector_copy(state->X + 3 * k, b);
    bool sensible = REAL(0.0) < s && s < SQUARE_MAX && vector_squared_length(d) < SQUARE_MAX; /* NaN is not */
    if (!sensible) {
        self->X_norm2 = squares_of_X(self);
    }
    if (sensible && self->config.skill) {
        skill_step(&self->skill, self->noise_variance, residual, map_here, dt);
    }
    if (!sensible || !correct(self, &h, S_bias, d, v)) {
        kalman_layer_estimate(self, Phi, nu, nu_cmd);
        return;
    }
    /* What the correction changed along each column, without another product. */
    real of_here = (h.form + bh) / v, of_ahead = (ah + ba) / v, of_path = (ph + bp) / v, of_bias = (bh + bb) / v;
    for (int axis = 0; axis < 3; axis++) {
        map_here[axis] += of_here * d[axis];
        on_path[axis] += of_path * d[axis];
    }
    vector_subtract(map_here, on_path, deviation);
    real keep = REAL(1.0) - self->config.fast_bias_rate * dt * (bh + bb) / s;
    gap_step(&self->gap, &self->PB, deviation, s / v, keep, t, dt);
    real share = self->config.confidence ? faded(self, &h, &a, of_here, of_ahead, v) : REAL(1.0);
    for (int axis = 0; axis < 3; axis++) {
        map_ahead[axis] = theta_ahead[axis] + share * (map_ahead[axis] + of_ahead * d[axis]);
    }
    skill_apply(&self->skill, on_path, map_ahead, nu_cmd);
    for (int axis = 0; axis < 3; axis++) {
        real bias = b[axis] + of_bias * d[axis];
        nu[axis] = map_here[axis] + bias;
        nu_cmd[axis] += bias + self->gap.values[axis];
    }
}
