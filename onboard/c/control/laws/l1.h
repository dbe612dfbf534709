/* L1 adaptive augmentation with the piecewise-constant law (Xargay, Hovakimyan, Cao 2010): the twin of
 * onboard/control/laws/l1.py.
 *
 * v_hat_dot = u_hat + sigma_hat - a (v_hat - v); sigma_hat = -[a / (e^{a T} - 1)] (v_hat - v); nu_ad = C(s) sigma_hat. */
#ifndef DMRAC_L1_H
#define DMRAC_L1_H

#include "control/laws/law.h"
#include "generated/config.h"

typedef struct {
    L1Config config;
    bool started;
    real rate[3];
    real error[3];
    real sigma[3];
    real nu[3];
} L1;

void l1_init(L1 *self, const L1Config *config);
void l1_step(L1 *self, const ChannelState *channel, ChannelTelemetry *telemetry, real nu_ad[3]);
void l1_reset(L1 *self);

#endif
