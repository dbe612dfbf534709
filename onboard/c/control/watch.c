#include "control/watch.h"

#include <string.h>

#include "control/reference_model.h"
#include "numerics/elementary.h"
#include "protocol/geometry.h"

/* ChannelWatch.__init__ */
void watch_init(ChannelWatch *self, const WatchConfig *config, int32_t channel, const ChannelGains *gains, real lambda,
                real gamma, const TrackingWeights *PB) {
    memset(self, 0, sizeof *self);
    self->config = *config;
    self->channel = channel;
    gains_stiffness(gains, self->K_1);
    gains_rate_gain(gains, self->K_2);
    self->rate = lambda;
    self->tracking = gamma;
    self->PB = *PB;
    watch_reset(self);
    watch_restart(self);
}

/* ChannelWatch.reset */
void watch_reset(ChannelWatch *self) {
    vector_zero(self->d);
    self->sent_first = self->sent_count = 0;
    self->ticks = 0;
    self->since_s = REAL(0.0);
}

/* ChannelWatch.restart */
void watch_restart(ChannelWatch *self) {
    vector_zero(self->delta_1);
    vector_zero(self->delta_2);
    vector_zero(self->misfits);
    self->errors[0] = self->errors[1] = self->trial[0] = self->trial[1] = REAL(0.0);
    self->worse_s = self->evidence_s = self->agreed_s = self->gain = REAL(0.0);
}

/* _squares */
static real squares(const real a[3], const real b[3]) {
    real difference[3];
    vector_subtract(a, b, difference);
    return vector_squared_length(difference);
}

/* Puts the comparison of now into the ring. Returns the place of the oldest one if its effect has come, else -1. */
static int32_t send(ChannelWatch *self, const real commanded[3], real dt) {
    int32_t place = (self->sent_first + self->sent_count) % SENT_MAX;
    vector_copy(commanded, self->sent_map + 3 * place);
    vector_copy(self->d, self->sent_bias + 3 * place);
    self->sent_count++;
    if ((real)self->sent_count * dt < self->config.lag_s[self->channel] && self->sent_count < SENT_MAX) {
        return -1;
    }
    int32_t oldest = self->sent_first;
    self->sent_first = (oldest + 1) % SENT_MAX;
    self->sent_count--;
    return oldest;
}

/* ChannelWatch._squared_errors: norm(K_1 e_1 + K_2 e_2)^2 as flown, and as it would be with the other law */
static void squared_errors(ChannelWatch *self, const real e[6], const real flown[3], const real other[3], real dt,
                           real *mine, real *would) {
    real *d1 = self->delta_1, *d2 = self->delta_2;
    *mine = *would = REAL(0.0);
    for (int i = 0; i < 3; i++) {
        real s = self->K_1[i], r = self->K_2[i];
        d2[i] += dt * (other[i] - flown[i] - s * d1[i] - r * d2[i]);
        d1[i] += dt * d2[i];
        real here = s * e[i] + r * e[3 + i];
        real there = here + s * d1[i] + r * d2[i];
        *mine += here * here;
        *would += there * there;
    }
}

/* ChannelWatch._compare: misfit and e of both laws, after `dt` */
static void compare(ChannelWatch *self, const real e[6], const real Delta_hat[3], const real now[3],
                    const real commanded[3], int32_t level, real dt) {
    static const real rest[3] = {REAL(0.0), REAL(0.0), REAL(0.0)};
    int32_t oldest = send(self, commanded, dt);
    if (oldest < 0) {
        return;
    }
    const real *then_map = self->sent_map + 3 * oldest, *then_bias = self->sent_bias + 3 * oldest;
    real fresh = real_min(dt / self->config.average_s, REAL(1.0));
    const real misfits[3] = {squares(then_map, Delta_hat), squares(then_bias, Delta_hat), squares(rest, Delta_hat)};
    for (int law = 0; law < 3; law++) {
        self->misfits[law] += fresh * (misfits[law] - self->misfits[law]);
    }
    bool map_flies = level == 0;
    real mine, would;
    squared_errors(self, e, map_flies ? now : self->d, map_flies ? self->d : now, dt, &mine, &would);
    self->errors[0] += fresh * ((map_flies ? mine : would) - self->errors[0]);
    self->errors[1] += fresh * ((map_flies ? would : mine) - self->errors[1]);
    real apart = self->config.disagreement[self->channel];
    if (squares(then_map, then_bias) > apart * apart) {
        self->evidence_s += dt;
        self->gain += dt * (misfits[1] - misfits[0]);
        real part = real_max(real_min(dt / self->config.trial_s, REAL(1.0)), dt / self->evidence_s);
        for (int law = 0; law < 2; law++) {
            self->trial[law] += part * (misfits[law] - self->trial[law]);
        }
    } else {
        self->agreed_s += dt;
    }
    bool worse = watch_worse(self, level, level + 1) != WATCH_NO_WORSE;
    self->worse_s = worse ? self->worse_s + dt : real_max(self->worse_s - dt, REAL(0.0));
}

/* ChannelWatch.step */
void watch_step(ChannelWatch *self, const ChannelState *channel, const real Delta_hat[3], const real now[3],
                const real commanded[3], int32_t level) {
    real dt = channel->dt, share = REAL(1.0) - real_exp(-self->rate * dt), pull = self->tracking * dt;
    const real *e = channel->model_error;
    for (int i = 0; i < 3; i++) {
        self->d[i] += share * (channel->residual[i] - self->d[i]);
        if (level == 1 && self->tracking > REAL(0.0)) {
            self->d[i] -= pull * (e[i] * self->PB.e_1[i] + e[3 + i] * self->PB.e_2[i]);
        }
    }
    self->since_s += dt;
    self->ticks++;
    if (self->ticks % WATCH_STRIDE == 0) {
        real since_s = self->since_s;
        self->since_s = REAL(0.0);
        compare(self, e, Delta_hat, now, commanded, level, since_s);
    }
}

/* ChannelWatch.worse */
WatchFinding watch_worse(const ChannelWatch *self, int32_t one, int32_t other) {
    if (one >= 2) {
        return WATCH_NO_WORSE;
    }
    const WatchConfig *config = &self->config;
    real margin = config->margin, misfit_floor = config->misfit_floor[self->channel];
    real error_floor = config->error_floor[self->channel];
    if (real_sqrt(self->misfits[one]) > margin * real_sqrt(self->misfits[other]) + misfit_floor) {
        return WATCH_MISFIT;
    }
    if (one == 0 && watch_loses(self, config->trial_s)) {
        return WATCH_TRIAL;
    }
    if (one == 0 && real_sqrt(self->errors[0]) > margin * real_sqrt(self->errors[1]) + error_floor) {
        return WATCH_MODEL_ERROR;
    }
    return WATCH_NO_WORSE;
}

/* ChannelWatch.loses */
bool watch_loses(const ChannelWatch *self, real evidence_s) {
    real margin = self->config.trial_margin;
    return self->evidence_s >= evidence_s && self->trial[0] > margin * margin * self->trial[1];
}

/* ChannelWatch.failed */
bool watch_failed(const ChannelWatch *self) {
    return self->worse_s >= self->config.worse_s;
}

/* ChannelWatch.stands */
bool watch_stands(const ChannelWatch *self, real evidence_s) {
    return self->evidence_s >= evidence_s && self->gain >= REAL(0.0) && watch_worse(self, 0, 1) == WATCH_NO_WORSE;
}

/* ChannelWatch.numbers */
void watch_numbers(const ChannelWatch *self, real numbers[4]) {
    for (int law = 0; law < 2; law++) {
        numbers[law] = real_sqrt(self->misfits[law]);
        numbers[2 + law] = real_sqrt(self->errors[law]);
    }
}
