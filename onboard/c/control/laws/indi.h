/* Incremental nonlinear dynamic inversion (INDI; Smeur, Chu, de Croon 2016): the twin of onboard/control/laws/indi.py.
 * u = u_0 + (demand - x_dot_0), both with the same filter: nu_ad = F(x_dot - u_hat). */
#ifndef DMRAC_INDI_H
#define DMRAC_INDI_H

#include "control/laws/law.h"
#include "generated/config.h"

/* F: first order, the same for x_dot and u_hat, so it sees their difference; bounded on each axis. */
typedef struct {
    real filter_s;
    real limit;
    real value[3]; /* units of u */
} IncrementalFilter;

void incremental_init(IncrementalFilter *self, real filter_s, real limit);

/* One step with x_dot - u_hat [3], or what is left of it. */
void incremental_step(IncrementalFilter *self, const real difference[3], real dt);
void incremental_reset(IncrementalFilter *self);

typedef struct {
    IncrementalFilter filter;
} Indi;

void indi_init(Indi *self, const IndiConfig *config);
void indi_step(Indi *self, const ChannelState *channel, ChannelTelemetry *telemetry, real nu_ad[3]);
void indi_reset(Indi *self);

#endif
