/* Repetitive control on top of INDI: the residual of earlier laps, by lap phase, read ahead by the lag of the loop. The
 * twin of onboard/control/laws/repetitive.py.
 *
 *     nu_ad  = T(theta + lead) + F(r - T(theta)),    F: first-order filter of INDI, r: the residual x_dot - u_hat
 *     T(b)  += share (mean of Delta_hat over bin b - T(b)),    once per lap; share = max(1 / laps, learning) */
#ifndef DMRAC_REPETITIVE_H
#define DMRAC_REPETITIVE_H

#include "control/laws/indi.h"
#include "control/laws/lap_table.h"

typedef struct {
    RepetitiveConfig config;
    LapTable table;
    int32_t laps[BINS_MAX];
    int32_t bin; /* that is measured; -1: none */
    real sum[3];
    int32_t count;
    real Delta_hat[3];
    IncrementalFilter rest;
    real now[3];
    real nu[3];
} Repetitive;

void repetitive_init(Repetitive *self, const RepetitiveConfig *config);
void repetitive_step(Repetitive *self, const ChannelState *channel, ChannelTelemetry *telemetry, real nu_ad[3]);

/* Set the filters to zero. The table stays. */
void repetitive_reset(Repetitive *self);

#endif
