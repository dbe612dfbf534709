#include "protocol/statistics.h"

#include <string.h>

#include "numerics/whole.h"

#define MEAN_OVER 32

void link_statistics_init(LinkStatistics *self) {
    memset(self, 0, sizeof *self);
    self->last_received_ns = NEVER_NS;
}

/* LinkStatistics.count_received */
void link_statistics_count_received(LinkStatistics *self, size_t size, int64_t delay_ns, int64_t now_ns) {
    if (self->received > 0) {
        self->longest_gap_ns = whole_max(self->longest_gap_ns, now_ns - self->last_received_ns);
    }
    self->last_received_ns = now_ns;
    self->received++;
    self->received_bytes += (int64_t)size;
    self->delay_ns = delay_ns;
    self->delay_mean_ns += ((double)delay_ns - self->delay_mean_ns) / (double)whole_min(self->received, MEAN_OVER);
    self->delay_max_ns = whole_max(self->delay_max_ns, delay_ns);
}

/* LinkStatistics.rejected.total() */
int64_t link_statistics_rejected(const LinkStatistics *self) {
    int64_t sum = 0;
    for (int i = 0; i < REJECTION_COUNT; i++) {
        sum += self->rejected[i];
    }
    return sum;
}

/* LinkStatistics.age_ns, compared */
bool link_statistics_is_silent(const LinkStatistics *self, int64_t time_ns, int64_t now_ns) {
    return self->received > 0 && now_ns - self->last_received_ns >= time_ns;
}
