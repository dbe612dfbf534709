/* The thrust scale k: what share of the modelled thrust the motors really give, estimated in flight. The twin of
 * onboard/control/thrust_scale.py, which explains it. With T_0 = m g and the rate r [1/s],
 *
 *     k_dot = r (T / T_0)^2 (-f_z m / T - k),    r_dot = 1 / tau^2 - (r T / T_0)^2 */
#ifndef DMRAC_THRUST_SCALE_H
#define DMRAC_THRUST_SCALE_H

#include "generated/config.h"

typedef struct {
    ThrustScaleConfig config;
    real mass_kg;
    real dt;       /* s */
    real fastest;  /* 1/s */
    real thrust_n; /* of the last tick, that of nominal motors */
    real rate;     /* r, 1/s */
    real value;    /* k: true specific thrust as a multiple of the nominal one */
} ThrustScale;

void thrust_scale_init(ThrustScale *self, const ThrustScaleConfig *config, const AirframeConfig *airframe,
                       real period_s);

/* Start over, as at the beginning of a flight. */
void thrust_scale_reset(ThrustScale *self);

/* Learn from one tick. `specific_force_z`: m/s^2, body FRD: negative in hover. `delivered_n`: N, collective thrust now, by
 * the actuator model with the present k. `adapt`: whether what is measured may be learnt from. */
void thrust_scale_step(ThrustScale *self, real specific_force_z, real delivered_n, bool adapt);

#endif
