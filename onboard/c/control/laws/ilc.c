#include "control/laws/ilc.h"

#include <string.h>

#include "control/reference_model.h"
#include "numerics/elementary.h"
#include "protocol/geometry.h"

/* A Fourier coefficient. */
typedef struct {
    real re;
    real im;
} Complex;

/* IterativeLearning.__init__ */
void ilc_init(IterativeLearning *self, const IterativeLearningConfig *config, const ChannelGains *gains) {
    memset(self, 0, sizeof *self);
    self->config = *config;
    gains_stiffness(gains, self->K_1);
    gains_rate_gain(gains, self->K_2);
    lap_table_init(&self->table, config->bins, config->filter_s);
    self->last_phase = -1.0;
    incremental_init(&self->rest, config->filter_s, config->limit);
    for (int32_t k = 0; k < config->bins; k++) {
        real angle = REAL(2.0) * REAL_PI * (real)k / (real)config->bins;
        self->cosine[k] = real_cos(angle);
        self->sine[k] = real_sin(angle);
    }
}

/* A coefficient of np.fft.rfft, of the column of `values` [bins, 3] that begins there; `counts` divide it if given. */
static Complex coefficient(const IterativeLearning *self, const real *values, const int32_t *counts, int32_t harmonic) {
    Complex sum = {REAL(0.0), REAL(0.0)};
    int32_t bins = self->config.bins, turn = 0;
    for (int32_t k = 0; k < bins; k++) {
        real value = counts ? values[3 * k] / (real)counts[k] : values[3 * k];
        sum.re += value * self->cosine[turn];
        sum.im -= value * self->sine[turn];
        turn = (turn + harmonic) % bins;
    }
    return sum;
}

/* np.fft.irfft of `learnt` at one bin. A last harmonic of half the bins counts once, the others twice. */
static real inverse_at(const IterativeLearning *self, int32_t bin) {
    int32_t bins = self->config.bins, turn = 0;
    real sum = REAL(0.0);
    for (int32_t m = 0; m <= bins / 2; m++) {
        real weight = m == 0 || 2 * m == bins ? REAL(1.0) : REAL(2.0);
        sum += weight * (self->learnt[2 * m] * self->cosine[turn] - self->learnt[2 * m + 1] * self->sine[turn]);
        turn = (turn + bin) % bins;
    }
    return sum / (real)bins;
}

/* Q (T - learning L e) of one harmonic and axis */
static Complex learn_harmonic(const IterativeLearning *self, int axis, int32_t harmonic, real lap_s) {
    const IterativeLearningConfig *config = &self->config;
    real omega = REAL(2.0) * REAL_PI / lap_s * (real)harmonic;
    real ratio = omega / (REAL(2.0) * REAL_PI * config->cutoff_hz);
    real Q = real_exp(REAL(-0.5) * ratio * ratio);
    real c = real_cos(omega * config->lead_s), s = real_sin(omega * config->lead_s);
    real a = self->K_1[axis] - omega * omega, b = omega * self->K_2[axis];
    Complex L = {a * c - b * s, a * s + b * c};
    Complex e = coefficient(self, self->sums + axis, self->counts, harmonic);
    Complex T = coefficient(self, self->table.values + axis, 0, harmonic);
    T.re = Q * (T.re - config->learning * (L.re * e.re - L.im * e.im));
    T.im = Q * (T.im - config->learning * (L.re * e.im + L.im * e.re));
    return T;
}

/* IterativeLearning._learn: T <- Q (T - learning L e) */
static void learn(IterativeLearning *self, real lap_s) {
    int32_t bins = self->config.bins;
    real limit = self->config.limit;
    for (int axis = 0; axis < 3; axis++) {
        for (int32_t m = 0; m <= bins / 2; m++) {
            Complex one = learn_harmonic(self, axis, m, lap_s);
            self->learnt[2 * m] = one.re;
            self->learnt[2 * m + 1] = one.im;
        }
        for (int32_t k = 0; k < bins; k++) {
            self->table.values[3 * k + axis] = real_clip(inverse_at(self, k), -limit, limit);
        }
    }
    self->laps++;
}

static void forget_lap(IterativeLearning *self) {
    memset(self->sums, 0, sizeof self->sums);
    memset(self->counts, 0, sizeof self->counts);
}

static bool is_complete(const IterativeLearning *self) {
    for (int32_t k = 0; k < self->config.bins; k++) {
        if (self->counts[k] == 0) {
            return false;
        }
    }
    return true;
}

/* IterativeLearning._record: add the tracking error to its bin; learn when a lap is complete, discard a lap with a gap */
static void record(IterativeLearning *self, const ChannelState *channel) {
    double phase = channel->lap_phase;
    if (phase < self->last_phase) {
        if (phase >= 0.0 && is_complete(self)) {
            learn(self, channel->lap_s);
        }
        forget_lap(self);
    }
    self->last_phase = phase;
    if (phase >= 0.0) {
        int32_t at = lap_table_bin(&self->table, phase);
        vector_add(self->sums + 3 * at, channel->tracking_error, self->sums + 3 * at);
        self->counts[at]++;
    }
}

/* IterativeLearning.step */
void ilc_step(IterativeLearning *self, const ChannelState *channel, ChannelTelemetry *telemetry, real nu_ad[3]) {
    if (channel->adapt) {
        real limit = self->config.limit, table[3];
        record(self, channel);
        lap_table_follow(&self->table, channel->lap_phase, channel->dt);
        lap_table_ahead(&self->table, REAL(0.0), table);
        incremental_step(&self->rest, channel->residual, channel->dt);
        for (int i = 0; i < 3; i++) {
            self->nu[i] = real_clip(table[i] + self->rest.value[i], -limit, limit);
        }
    }
    vector_copy(self->nu, telemetry->adaptive_now);
    vector_copy(self->nu, nu_ad);
}

/* IterativeLearning.reset */
void ilc_reset(IterativeLearning *self) {
    lap_table_reset(&self->table);
    forget_lap(self);
    self->last_phase = -1.0;
    incremental_reset(&self->rest);
    vector_zero(self->nu);
}
