/* The integral of a PID controller: the twin of onboard/control/laws/integral.py.
 * nu_ad = -K_i int(target - state) dt, held while the motors are saturated and clamped (anti-windup). */
#ifndef DMRAC_INTEGRAL_H
#define DMRAC_INTEGRAL_H

#include "control/laws/law.h"
#include "generated/config.h"

typedef struct {
    real gain[3];
    real limit;
    real nu[3];
} Integral;

void integral_init(Integral *self, const IntegralConfig *config);
void integral_step(Integral *self, const ChannelState *channel, ChannelTelemetry *telemetry, real nu_ad[3]);
void integral_reset(Integral *self);

#endif
