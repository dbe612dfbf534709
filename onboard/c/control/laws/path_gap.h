/* What a map says at the vehicle beside its path, as far as the law (2a) commands it. The twin of
 * onboard/control/laws/path_gap.py, which explains it:
 *
 *     e_g_dot_dot = -K_1 e_g - K_2 e_g_dot + gap - m
 *     gap += s / (R_t + s) (m - gap - t e_g'PB) - s_b dt gap */
#ifndef DMRAC_PATH_GAP_H
#define DMRAC_PATH_GAP_H

#include "control/laws/last_layer.h"

typedef struct {
    real values[3];
    real error[3];
    real rate[3];
} PathGap;

/* The deviation m counts in full; NULL: there is none. */
void gap_close(PathGap *self, const real *deviation);

/* One tick: share s / (R_t + s) of the law's tick, keep 1 - s_b dt by the share that b has in s, t the factor of e'PB. */
void gap_step(PathGap *self, const TrackingWeights *PB, const real deviation[3], real share, real keep, real t,
              real dt);

#endif
