#include "links/loss_rate.h"

#include <string.h>

#include "numerics/elementary.h"
#include "numerics/whole.h"

/* LossRate.__init__ */
void loss_rate_init(LossRate *self) {
    memset(self, 0, sizeof *self);
}

/* LossRate.step */
real loss_rate_step(LossRate *self, const LinkStatistics *statistics, int64_t now_ns) {
    if (now_ns < self->ends_ns) {
        return self->share;
    }
    int64_t received = statistics->received - self->received;
    if (received > 0) {
        bool queueing = statistics->delay_mean_ns > (double)QUEUEING_NS;
        int64_t lost = queueing ? 0 : whole_max(statistics->lost - self->lost, 0);
        real share = (real)lost / (real)(received + lost);
        self->share = real_min(share, self->last_share);
        self->last_share = share;
    } else if (link_statistics_is_silent(statistics, SILENT_NS, now_ns)) {
        self->share = self->last_share = REAL(0.0);
    }
    self->received = statistics->received;
    self->lost = statistics->lost;
    self->ends_ns = now_ns + LOSS_WINDOW_NS;
    return self->share;
}
