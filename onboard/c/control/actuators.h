/* The actuator model: the thrust that the motors deliver now, from which u_hat follows. The twin of
 * onboard/control/actuators.py. */
#ifndef DMRAC_ACTUATORS_H
#define DMRAC_ACTUATORS_H

#include "generated/config.h"

/* What the motors deliver at the present. */
typedef struct {
    real thrusts_n[4]; /* N, motor by motor */
    real thrust_n;     /* N, collective */
    real torque_nm[3]; /* N m, body */
} Delivered;

/* First-order lag from commanded to delivered thrust, faster up than down, and its compensation. */
typedef struct {
    AirframeConfig config;
    real up;
    real down;
    real lead_up;
    real lead_down;
    real max;
    real min;
    Delivered delivered;
} ActuatorModel;

void actuators_init(ActuatorModel *self, const AirframeConfig *config, real period_s);

/* Advance by one period under the thrusts [N] commanded during it; the result is `delivered`. */
void actuators_step(ActuatorModel *self, const real commanded[4]);

/* What the motors will deliver one period later under these thrusts [N]; nothing changes. */
void actuators_ahead(const ActuatorModel *self, const real commanded[4], Delivered *out);

/* The command [N] that brings the motors to `wanted` with motor_response_s, within their limits. */
void actuators_overdriven(const ActuatorModel *self, const real wanted[4], real command[4]);

#endif
