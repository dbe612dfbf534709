#include "control/actuators.h"

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
    self->max = config->motor_thrust_max_n;
    self->min = config->motor_thrust_min_share * self->max;
    self->delivered = (Delivered){{0}, 0, {0}};
}

/* ActuatorModel.step */
void actuators_step(ActuatorModel *self, const real commanded[4]) {
    Delivered later;
    actuators_ahead(self, commanded, &later);
    self->delivered = later;
}

/* ActuatorModel.ahead */
void actuators_ahead(const ActuatorModel *self, const real commanded[4], Delivered *out) {
    for (int i = 0; i < 4; i++) {
        real now = self->delivered.thrusts_n[i], command = commanded[i];
        out->thrusts_n[i] = now + (command > now ? self->up : self->down) * (command - now);
    }
    real total[4];
    wrench(&self->config, out->thrusts_n, total);
    out->thrust_n = total[0];
    for (int i = 0; i < 3; i++) {
        out->torque_nm[i] = total[1 + i];
    }
}

/* ActuatorModel._driven: the motors obey T_dot = (command - T) / lag; the command makes that (wanted - T) / response */
static real driven(const ActuatorModel *self, real now, real wanted) {
    real gap = wanted - now;
    real command = wanted + (gap > REAL(0.0) ? self->lead_up : self->lead_down) * gap;
    return real_min(real_max(command, self->min), self->max);
}

/* ActuatorModel.overdriven */
void actuators_overdriven(const ActuatorModel *self, const real wanted[4], real command[4]) {
    for (int i = 0; i < 4; i++) {
        command[i] = driven(self, self->delivered.thrusts_n[i], wanted[i]);
    }
}
