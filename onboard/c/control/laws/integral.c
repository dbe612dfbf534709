#include "control/laws/integral.h"

#include "numerics/elementary.h"
#include "protocol/geometry.h"

/* Integral.__init__ */
void integral_init(Integral *self, const IntegralConfig *config) {
    vector_copy(config->gain, self->gain);
    self->limit = config->limit;
    vector_zero(self->nu);
}

/* Integral.step */
void integral_step(Integral *self, const ChannelState *channel, ChannelTelemetry *telemetry, real nu_ad[3]) {
    for (int axis = 0; channel->adapt && axis < 3; axis++) {
        real now = self->nu[axis];
        real change = -channel->dt * self->gain[axis] * channel->tracking_error[axis];
        if (channel->saturated && !(change * now < REAL(0.0))) { /* anti-windup: only unwinding is allowed */
            continue;
        }
        self->nu[axis] = real_min(real_max(now + change, -self->limit), self->limit);
    }
    vector_copy(self->nu, telemetry->adaptive_now);
    vector_copy(self->nu, nu_ad);
}

/* Integral.reset */
void integral_reset(Integral *self) {
    vector_zero(self->nu);
}
