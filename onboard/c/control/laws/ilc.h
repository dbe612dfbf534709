/* Iterative learning control (ILC) on top of INDI: a correction over the lap, updated once per lap. The twin of
 * onboard/control/laws/ilc.py, which explains it.
 *
 *     nu_ad   = T(theta) + F(r),    F: first-order filter of INDI, r: the residual x_dot - u_hat
 *     T      <- Q (T - learning L e),    e: tracking error of the whole lap, by lap phase
 *     L(omega) = (K_1 + j omega K_2 - omega^2) e^(j omega lead),    Q(omega) = e^(-(omega / cutoff)^2 / 2)
 *
 * The Fourier coefficients are sums over all bins: bins^2 operations, once per lap. */
#ifndef DMRAC_ILC_H
#define DMRAC_ILC_H

#include "control/laws/indi.h"
#include "control/laws/lap_table.h"

#define HARMONICS_MAX (BINS_MAX / 2 + 1)

typedef struct {
    IterativeLearningConfig config;
    real K_1[3];
    real K_2[3];
    LapTable table;
    int32_t laps; /* that the table has learnt from */
    real sums[BINS_MAX * 3];
    int32_t counts[BINS_MAX];
    double last_phase;
    IncrementalFilter rest;
    real nu[3];
    real cosine[BINS_MAX]; /* of 2 pi k / bins */
    real sine[BINS_MAX];
    real learnt[HARMONICS_MAX * 2]; /* real and imaginary part, of one axis */
} IterativeLearning;

void ilc_init(IterativeLearning *self, const IterativeLearningConfig *config, const ChannelGains *gains);
void ilc_step(IterativeLearning *self, const ChannelState *channel, ChannelTelemetry *telemetry, real nu_ad[3]);

/* Set the filter to zero and discard the present lap. The table stays. */
void ilc_reset(IterativeLearning *self);

#endif
