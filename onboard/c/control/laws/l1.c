#include "control/laws/l1.h"

#include "numerics/elementary.h"
#include "protocol/geometry.h"

/* L1.__init__ */
void l1_init(L1 *self, const L1Config *config) {
    *self = (L1){.config = *config};
}

/* L1._predict */
static void predict(L1 *self, const ChannelState *channel) {
    real a = self->config.predictor_pole_rad_s, T = channel->dt;
    real decay = real_exp(-a * T);
    real share = REAL(1.0) - real_exp(-self->config.bandwidth_rad_s * T);
    real limit = self->config.limit;
    for (int i = 0; i < 3; i++) {
        real v = channel->rate[i], error = REAL(0.0);
        if (!self->started) {
            self->sigma[i] = self->nu[i];
        } else {
            /* Exact for u_hat and sigma_hat constant since the last step: v_tilde decays, the rest integrates. u_hat
             * and the length of the step are known only now. */
            real prediction = self->rate[i] + decay * self->error[i] + ((REAL(1.0) - decay) / a) * self->sigma[i];
            error = prediction + T * channel->u_hat[i] - v;
            self->sigma[i] = -(a * decay / (REAL(1.0) - decay)) * error;
        }
        self->rate[i] = v;
        self->error[i] = error;
        self->nu[i] = real_clip(self->nu[i] + share * (self->sigma[i] - self->nu[i]), -limit, limit);
    }
    self->started = true;
}

/* L1.step */
void l1_step(L1 *self, const ChannelState *channel, ChannelTelemetry *telemetry, real nu_ad[3]) {
    if (channel->adapt) {
        predict(self, channel);
    } else {
        self->started = false;
    }
    vector_copy(self->nu, telemetry->adaptive_now);
    vector_copy(self->nu, nu_ad);
}

/* L1.reset */
void l1_reset(L1 *self) {
    self->started = false;
    vector_zero(self->sigma);
    vector_zero(self->nu);
}
