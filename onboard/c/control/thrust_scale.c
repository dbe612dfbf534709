#include "control/thrust_scale.h"

#include "generated/constants.h"
#include "numerics/elementary.h"

/* ThrustScale.__init__ */
void thrust_scale_init(ThrustScale *self, const ThrustScaleConfig *config, const AirframeConfig *airframe,
                       real period_s) {
    self->config = *config;
    self->mass_kg = airframe->mass_kg;
    self->dt = period_s;
    self->fastest = REAL(1.0) / config->start_time_constant_s;
    self->thrust_n = REAL(0.0);
    thrust_scale_reset(self);
}

/* ThrustScale.reset */
void thrust_scale_reset(ThrustScale *self) {
    self->value = REAL(1.0);
    self->rate = self->fastest;
}

/* ThrustScale.step */
void thrust_scale_step(ThrustScale *self, real specific_force_z, real delivered_n, bool adapt) {
    const ThrustScaleConfig *config = &self->config;
    real now = delivered_n / self->value, dt = self->dt;
    real thrust = REAL(0.5) * (self->thrust_n + now);
    self->thrust_n = now;
    real load = thrust / (self->mass_kg * GRAVITY);
    if (!(config->enabled && adapt && load >= config->thrust_min_share && real_is_finite(specific_force_z))) {
        return;
    }
    real innovation = -specific_force_z / GRAVITY - self->value * load;
    real value = self->value + self->rate * dt * load * innovation;
    self->value = real_clip(value, config->least, config->greatest);
    real settled = REAL(1.0) / (config->time_constant_s * config->time_constant_s);
    real rate = self->rate + dt * (settled - (self->rate * load) * (self->rate * load));
    self->rate = real_clip(rate, REAL(0.0), self->fastest);
}
