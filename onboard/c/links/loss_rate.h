/* Estimates the share of the peer's datagrams that the radio loses at present: the twin of onboard/links/loss_rate.py, which
 * explains it. */
#ifndef DMRAC_LOSS_RATE_H
#define DMRAC_LOSS_RATE_H

#include "numerics/real.h"
#include "protocol/statistics.h"

typedef struct {
    real share;
    real last_share;
    int64_t ends_ns;
    int64_t received;
    int64_t lost;
} LossRate;

void loss_rate_init(LossRate *self);
/* Returns `share`, updated at the end of each window. */
real loss_rate_step(LossRate *self, const LinkStatistics *statistics, int64_t now_ns);

#endif
