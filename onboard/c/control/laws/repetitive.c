#include "control/laws/repetitive.h"

#include <string.h>

#include "numerics/elementary.h"
#include "protocol/geometry.h"

#define NO_BIN (-1)

/* Repetitive.__init__ */
void repetitive_init(Repetitive *self, const RepetitiveConfig *config) {
    memset(self, 0, sizeof *self);
    self->config = *config;
    lap_table_init(&self->table, config->bins, config->filter_s);
    self->bin = NO_BIN;
    incremental_init(&self->rest, config->filter_s, config->limit);
}

/* Repetitive._begin */
static void begin(Repetitive *self, int32_t bin) {
    self->bin = bin;
    self->count = 0;
    vector_zero(self->sum);
}

/* Repetitive._store */
static void store(Repetitive *self) {
    if (self->bin < 0) {
        return;
    }
    int32_t laps = ++self->laps[self->bin];
    real share = real_max(REAL(1.0) / (real)laps, self->config.learning);
    real *values = self->table.values + 3 * self->bin;
    for (int i = 0; i < 3; i++) {
        values[i] += share * (self->sum[i] / (real)self->count - values[i]);
    }
}

/* Repetitive._learn: average Delta_hat over the bin it was measured in, and store the mean when the next bin begins */
static void learn(Repetitive *self, const ChannelState *channel) {
    real filter_s = self->config.residual_filter_s;
    real share = REAL(1.0) - real_exp(-channel->dt / filter_s);
    for (int i = 0; i < 3; i++) {
        self->Delta_hat[i] = self->Delta_hat[i] + share * (channel->residual[i] - self->Delta_hat[i]);
    }
    if (channel->lap_phase < 0.0) {
        begin(self, NO_BIN);
        return;
    }
    int32_t measured = lap_table_bin(&self->table, channel->lap_phase - (double)(filter_s / channel->lap_s));
    if (measured != self->bin) {
        store(self);
        begin(self, measured);
    }
    vector_add(self->sum, self->Delta_hat, self->sum);
    self->count++;
}

/* Repetitive.step */
void repetitive_step(Repetitive *self, const ChannelState *channel, ChannelTelemetry *telemetry, real nu_ad[3]) {
    if (channel->adapt) {
        real limit = self->config.limit, now[3], ahead[3], rest[3];
        learn(self, channel);
        lap_table_follow(&self->table, channel->lap_phase, channel->dt);
        lap_table_ahead(&self->table, REAL(0.0), now);
        real lead = channel->lap_s > REAL(0.0) ? self->config.lead_s / channel->lap_s : REAL(0.0);
        lap_table_ahead(&self->table, lead, ahead);
        vector_subtract(channel->residual, now, rest);
        incremental_step(&self->rest, rest, channel->dt);
        for (int i = 0; i < 3; i++) {
            self->now[i] = real_clip(now[i] + self->rest.value[i], -limit, limit);
            self->nu[i] = real_clip(ahead[i] + self->rest.value[i], -limit, limit);
        }
    }
    vector_copy(self->now, telemetry->adaptive_now);
    vector_copy(self->Delta_hat, telemetry->residual);
    vector_copy(self->nu, nu_ad);
}

/* Repetitive.reset */
void repetitive_reset(Repetitive *self) {
    lap_table_reset(&self->table);
    incremental_reset(&self->rest);
    begin(self, NO_BIN);
    vector_zero(self->Delta_hat);
    vector_zero(self->now);
    vector_zero(self->nu);
}
