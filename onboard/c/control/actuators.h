/* The actuator model: the thrust that the motors deliver now, from which u_hat follows. The twin of
 * onboard/control/actuators.py. Commands are shares of the maximum thrust. The motors give
 * `scale` times the nominal one (control/thrust_scale.h). */
#ifndef DMRAC_ACTUATORS_H
#define DMRAC_ACTUATORS_H

#include "generated/config.h"
#include "generated/constants.h"

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
    real scale;     /* thrust of the motors as a multiple of the nominal one */
    real acting[4]; /* the command that acts now, shares */
    Delivered delivered;
} ActuatorModel;

void actuators_init(ActuatorModel *self, const AirframeConfig *config, real period_s);

/* Take over a new scale. The shares that the motors deliver stay as they are. */
void actuators_set_scale(ActuatorModel *self, real scale);

/* Advance by one period under the shares of the maximum thrust commanded during it; the result is `delivered`. */
void actuators_step(ActuatorModel *self, const real commanded[4]);

/* What was delivered at the end of each period since the last tick, the last one now: 1 + missed entries of `passed`, whose
 * number is returned. `missed`: ticks missed since then; more than CATCH_UP_MAX count as that many. A command acts one tick
 * after it was computed, and until the next one acts: `commanded`, of the last tick, acted in the periods of the missed
 * ticks, and the one before it in the first period. */
int32_t actuators_catch_up(ActuatorModel *self, const real commanded[4], int32_t missed, Delivered *passed);

/* What the motors will deliver one period later under these shares of the maximum thrust; nothing changes. */
void actuators_ahead(const ActuatorModel *self, const real commanded[4], Delivered *out);

/* The command, in shares, that brings the motors to `wanted` [N] with motor_response_s, within their limits. */
void actuators_overdriven(const ActuatorModel *self, const real wanted[4], real command[4]);

#endif
