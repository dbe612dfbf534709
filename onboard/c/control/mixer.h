/* The mixer: from collective thrust and body torque to four motor thrusts, and back. The twin of
 * onboard/control/mixer.py. Motor order is PX4 quad-X: 1 front right, 2 rear left, 3 front left, 4 rear right. */
#ifndef DMRAC_MIXER_H
#define DMRAC_MIXER_H

#include <stdbool.h>

#include "generated/config.h"

typedef struct {
    AirframeConfig config;
    real scale; /* thrust of the motors as a multiple of the nominal one; the caller sets it */
    real x;     /* 1/m: thrust of each motor per pitch torque */
    real y;     /* 1/m, the same for roll */
    real z;     /* 1/m, the same for yaw */
} Mixer;

void mixer_init(Mixer *self, const AirframeConfig *config);

/* Motor thrusts [N] closest to the demand [N, N m] within the limits of motors of that scale. There it reduces yaw first, then thrust,
 * then roll and pitch. */
void mixer_thrusts(const Mixer *self, real thrust_n, const real torque_nm[3], real thrusts[4]);

/* Whether `thrusts` deliver less than the demand in thrust, roll or pitch (yaw does not count). */
bool mixer_falls_short(const Mixer *self, const real thrusts[4], real thrust_n, const real torque_nm[3]);

/* Collective thrust [N] and body torque [N m] of four motors: out[4]. */
void wrench(const AirframeConfig *config, const real thrusts[4], real out[4]);

#endif
