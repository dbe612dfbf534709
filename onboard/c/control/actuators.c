#include "control/actuators.h"

#include <string.h>

#include "control/mixer.h"
#include "numerics/elementary.h"

static real lead(real lag_s, real response_s) {
    return real_max(lag_s / response_s, REAL(1.0)) - REAL(1.0);
}

/* ActuatorModel.__init__ */
void actuators_init(ActuatorModel *self, const AirframeConfig *config, real period_s) {
    self->config = *config;
    self->up = REAL(1.0) - real_exp(-period_s / config->motor_lag_up_s);
    self->down = REAL(1.0) - real_exp(-period_s / config->motor_lag_down_s);
    self->lead_up = lead(config->motor_lag_up_s, config->motor_response_s);
    self->lead_down = lead(config->motor_lag_down_s, config->motor_response_s);
    self->scale = REAL(1.0);
    memset(self->acting, 0, sizeof self->acting);
    self->delivered = (Delivered){{0}, 0, {0}};
}

/* ActuatorModel.scale */
void actuators_set_scale(ActuatorModel *self, real scale) {
    real ratio = scale / self->scale;
    self->scale = scale;
    for (int i = 0; i < 4; i++) {
        self->delivered.thrusts_n[i] *= ratio;
    }
    self->delivered.thrust_n *= ratio;
    for (int i = 0; i < 3; i++) {
        self->delivered.torque_nm[i] *= ratio;
    }
}

/* ActuatorModel.step */
void actuators_step(ActuatorModel *self, const real commanded[4]) {
    Delivered later;
    actuators_ahead(self, commanded, &later);
    self->delivered = later;
}

/* ActuatorModel.catch_up */
int32_t actuators_catch_up(ActuatorModel *self, const real commanded[4], int32_t missed, Delivered *passed) {
    int32_t count = 1 + (missed < 0 ? 0 : missed < CATCH_UP_MAX ? missed : CATCH_UP_MAX);
    for (int i = 0; i < count; i++) {
        actuators_step(self, i == 0 ? self->acting : commanded);
        passed[i] = self->delivered;
    }
    memcpy(self->acting, commanded, sizeof self->acting);
    return count;
}

/* ActuatorModel.ahead */
void actuators_ahead(const ActuatorModel *self, const real commanded[4], Delivered *out) {
    real most = self->scale * self->config.motor_thrust_max_n;
    for (int i = 0; i < 4; i++) {
        real now = self->delivered.thrusts_n[i], command = most * commanded[i];
        out->thrusts_n[i] = now + (command > now ? self->up : self->down) * (command - now);
    }
    real total[4];
    wrench(&self->config, out->thrusts_n, total);
    out->thrust_n = total[0];
    for (int i = 0; i < 3; i++) {
        out->torque_nm[i] = total[1 + i];
    }
}

/* ActuatorModel.overdriven */
void actuators_overdriven(const ActuatorModel *self, const real wanted[4], real command[4]) {
    real most = self->scale * self->config.motor_thrust_max_n;
    real leads[4], upwards = REAL(0.0), possible = REAL(0.0);
    for (int i = 0; i < 4; i++) {
        real gap = wanted[i] - self->delivered.thrusts_n[i];
        leads[i] = (gap > REAL(0.0) ? self->lead_up : self->lead_down) * gap;
        if (leads[i] > REAL(0.0)) {
            upwards += leads[i];
            possible += real_min(leads[i], real_max(most - wanted[i], REAL(0.0)));
        }
    }
    real share = upwards > REAL(0.0) ? possible / upwards : REAL(1.0);
    for (int i = 0; i < 4; i++) {
        real asked = (wanted[i] + (leads[i] > REAL(0.0) ? leads[i] : share * leads[i])) / most;
        command[i] = real_min(real_max(asked, self->config.motor_thrust_min_share), REAL(1.0));
    }
}
