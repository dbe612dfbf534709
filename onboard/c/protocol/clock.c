#include "protocol/clock.h"

#include <string.h>

#include "numerics/whole.h"

void forward_clock_init(ForwardClock *self) {
    memset(self, 0, sizeof *self);
}

/* ForwardClock.at */
int64_t forward_clock_at(ForwardClock *self, int64_t now_ns) {
    now_ns += self->shift_ns;
    if (self->started && now_ns < self->latest_ns) {
        self->shift_ns += self->latest_ns - now_ns;
        self->jumps++;
        return self->latest_ns;
    }
    self->started = true;
    self->latest_ns = now_ns;
    return now_ns;
}

/* ClockEstimate.__init__ */
void clock_estimate_init(ClockEstimate *self) {
    memset(self, 0, sizeof *self);
}

/* ClockEstimate.restart */
void clock_estimate_restart(ClockEstimate *self) {
    self->next = self->count = 0;
}

bool clock_estimate_is_known(const ClockEstimate *self) {
    return self->count > 0;
}

static void forget_request(ClockEstimate *self, int32_t index) {
    self->open_count--;
    memmove(self->open + index, self->open + index + 1, (size_t)(self->open_count - index) * sizeof *self->open);
}

/* ClockEstimate.note_request */
void clock_estimate_note_request(ClockEstimate *self, int64_t origin_ns) {
    if (self->open_count == OPEN_REQUESTS_MAX) {
        forget_request(self, 0);
    }
    self->open[self->open_count++] = origin_ns;
}

/* The place of the first open request with this origin; -1 if there is none */
static int32_t find_request(const ClockEstimate *self, int64_t origin_ns) {
    for (int32_t i = 0; i < self->open_count; i++) {
        if (self->open[i] == origin_ns) {
            return i;
        }
    }
    return -1;
}

/* ClockEstimate.is_open */
bool clock_estimate_is_open(const ClockEstimate *self, int64_t origin_ns, int64_t now_ns) {
    int64_t age_ns = whole_difference(now_ns, origin_ns);
    return find_request(self, origin_ns) >= 0 && 0 <= age_ns && age_ns <= REQUEST_LIFE_NS;
}

/* The order of numpy's core: by round trip, then by offset */
static bool is_better(const ClockExchange *one, const ClockExchange *other) {
    if (one->round_trip_ns != other->round_trip_ns) {
        return one->round_trip_ns < other->round_trip_ns;
    }
    return one->offset_ns < other->offset_ns;
}

static void add_exchange(ClockEstimate *self, ClockExchange exchange) {
    self->exchanges[self->next] = exchange;
    self->next = (self->next + 1) % CLOCK_SAMPLES_MAX;
    self->count = self->count < CLOCK_SAMPLES_MAX ? self->count + 1 : CLOCK_SAMPLES_MAX;
    self->best = self->exchanges[0];
    for (int32_t i = 1; i < self->count; i++) {
        if (is_better(self->exchanges + i, &self->best)) {
            self->best = self->exchanges[i];
        }
    }
}

/* ClockEstimate.receive_reply. Times are not negative, so that no difference of two leaves the type. */
bool clock_estimate_receive_reply(ClockEstimate *self, int64_t origin_ns, int64_t receive_ns, int64_t transmit_ns,
                                  int64_t now_ns) {
    if (!clock_estimate_is_open(self, origin_ns, now_ns)) {
        return false;
    }
    int64_t round_trip_ns = (now_ns - origin_ns) - (transmit_ns - receive_ns);
    if (round_trip_ns < 0) {
        return false;
    }
    forget_request(self, find_request(self, origin_ns));
    ClockExchange exchange = {round_trip_ns, whole_mean(receive_ns - origin_ns, transmit_ns - now_ns)};
    if (self->count > 0) {
        int64_t error_ns = (round_trip_ns + self->best.round_trip_ns) / 2 + JUMP_SLACK_NS;
        if (whole_distance(exchange.offset_ns, self->best.offset_ns) > (uint64_t)error_ns) {
            clock_estimate_restart(self);
            self->jumps++;
        }
    }
    add_exchange(self, exchange);
    return true;
}
