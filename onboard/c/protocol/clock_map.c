#include "protocol/clock_map.h"

#include <string.h>

#include "numerics/whole.h"

static const LeastDelays NO_DELAYS = {INT64_MAX, INT64_MAX};

/* ClockMap.reset */
void clock_map_init(ClockMap *self) {
    memset(self, 0, sizeof *self);
    self->current.delays = self->window = NO_DELAYS;
}

/* _two_least: of those so far and one more */
static void keep_least(LeastDelays *self, int64_t delay_ns) {
    if (delay_ns < self->least_ns) {
        self->second_ns = self->least_ns;
        self->least_ns = delay_ns;
    } else if (delay_ns < self->second_ns) {
        self->second_ns = delay_ns;
    }
}

static void keep_both(LeastDelays *self, LeastDelays other) {
    keep_least(self, other.least_ns);
    keep_least(self, other.second_ns);
}

/* ClockMap.is_ahead */
bool clock_map_is_ahead(const ClockMap *self, int64_t delay_ns) {
    return self->known && delay_ns < whole_difference(self->offset_ns, AHEAD_NS);
}

/* ClockMap._turn: begin a new bucket, and forget those that have left the window */
static void turn(ClockMap *self, int64_t bucket) {
    DelayBucket ended = self->current, kept[CLOCK_BUCKETS + 1];
    int32_t count = 0;
    memcpy(kept, self->sealed, sizeof self->sealed);
    kept[self->sealed_count] = ended;
    for (int32_t i = 0; self->known && i <= self->sealed_count; i++) {
        if (kept[i].index > bucket - CLOCK_BUCKETS) {
            self->sealed[count++] = kept[i];
        }
    }
    self->sealed_count = count;
    self->current = (DelayBucket){bucket, NO_DELAYS};
    self->window = NO_DELAYS;
    for (int32_t i = 0; i < count; i++) {
        keep_both(&self->window, self->sealed[i].delays);
    }
}

/* ClockMap.add */
void clock_map_add(ClockMap *self, int64_t delay_ns, int64_t arrival_ns) {
    int64_t bucket = whole_floor_divide(arrival_ns, CLOCK_BUCKET_NS);
    if (!self->known || bucket > self->current.index) {
        turn(self, bucket);
    }
    keep_least(&self->current.delays, delay_ns);
    LeastDelays all = self->window;
    keep_both(&all, self->current.delays);
    self->offset_ns = all.second_ns == INT64_MAX ? all.least_ns : all.second_ns;
    self->known = true;
}

/* ClockMap.to_ours */
int64_t clock_map_to_ours(const ClockMap *self, int64_t stamp_ns, int64_t arrival_ns) {
    return whole_min(whole_sum(stamp_ns, self->offset_ns), arrival_ns);
}
