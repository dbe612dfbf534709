#include "control/laws/indi.h"

#include "numerics/elementary.h"
#include "protocol/geometry.h"

/* IncrementalFilter.__init__ */
void incremental_init(IncrementalFilter *self, real filter_s, real limit) {
    self->filter_s = filter_s;
    self->limit = limit;
    vector_zero(self->value);
}

/* IncrementalFilter.step */
void incremental_step(IncrementalFilter *self, const real difference[3], real dt) {
    real share = REAL(1.0) - real_exp(-dt / self->filter_s);
    for (int i = 0; i < 3; i++) {
        real next = self->value[i] + share * (difference[i] - self->value[i]);
        self->value[i] = real_clip(next, -self->limit, self->limit);
    }
}

/* IncrementalFilter.reset */
void incremental_reset(IncrementalFilter *self) {
    vector_zero(self->value);
}

/* Indi.__init__ */
void indi_init(Indi *self, const IndiConfig *config) {
    incremental_init(&self->filter, config->filter_s, config->limit);
}

/* Indi.step */
void indi_step(Indi *self, const ChannelState *channel, ChannelTelemetry *telemetry, real nu_ad[3]) {
    if (channel->adapt) {
        incremental_step(&self->filter, channel->residual, channel->dt);
    }
    vector_copy(self->filter.value, telemetry->adaptive_now);
    vector_copy(self->filter.value, nu_ad);
}

/* Indi.reset */
void indi_reset(Indi *self) {
    incremental_reset(&self->filter);
}
