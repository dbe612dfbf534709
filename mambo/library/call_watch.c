#include "call_watch.h"

#include <string.h>

#include "numerics/elementary.h"

static int64_t in_ns(real seconds) {
    return (int64_t)(1e9 * (double)seconds);
}

void call_watch_init(CallWatch *self, const BoardWatchdogs *config, int64_t period_ns) {
    memset(self, 0, sizeof *self);
    self->config = *config;
    self->period_ns = period_ns;
}

/* --- when it is called --- */

static void count_block(CallWatch *self, int64_t now_ns, int64_t gap_ns) {
    if (gap_ns > self->block_gap_ns) {
        self->block_gap_ns = gap_ns;
    }
    if (++self->block_calls < WATCHED_CALLS) {
        return;
    }
    self->rate_hz = (real)((double)self->block_calls * 1e9 / (double)(now_ns - self->block_ns));
    self->gap_ns = self->block_gap_ns;
    self->block_ns = now_ns;
    self->block_calls = 0;
    self->block_gap_ns = 0;
}

CallVerdict call_watch_begin(CallWatch *self, int64_t now_ns) {
    int64_t gap_ns = now_ns - self->call_ns;
    if (!self->started) {
        self->started = true;
        self->call_ns = self->block_ns = self->stage_ns = now_ns;
        self->calls = 1;
        return CALL_FIRST;
    }
    if (gap_ns < in_ns(self->config.twice_s)) {
        self->twice++;
        return CALL_TWICE;
    }
    self->calls++;
    self->call_ns = now_ns;
    self->missed +=
        gap_ns > self->period_ns + self->period_ns / 2 ? (gap_ns + self->period_ns / 2) / self->period_ns - 1 : 0;
    count_block(self, now_ns, gap_ns);
    if (gap_ns > in_ns(self->config.late_stop_s)) {
        self->late++;
        return CALL_TOO_LATE;
    }
    if (gap_ns > in_ns(self->config.late_land_s)) {
        self->late++;
        return CALL_LATE;
    }
    return CALL_ON_TIME;
}

bool call_watch_wrong_rate(const CallWatch *self) {
    real rate_hz = self->rate_hz;
    return rate_hz > REAL(0.0) && (rate_hz < self->config.rate_min_hz || rate_hz > self->config.rate_max_hz);
}

/* --- how long it takes --- */

static void enter(CallWatch *self, BudgetStage stage, int64_t now_ns) {
    self->stage = stage;
    self->stage_ns = now_ns;
    memset(self->over, 0, sizeof self->over);
    self->over_count = self->calm = 0;
}

bool call_watch_end(CallWatch *self, int64_t end_ns) {
    int64_t duration_ns = end_ns - self->call_ns;
    bool over = duration_ns > in_ns(self->config.budget_s);
    if (duration_ns > self->longest_ns) {
        self->longest_ns = duration_ns;
    }
    self->over_count += (int32_t)over - (int32_t)self->over[self->at];
    self->over[self->at] = over;
    self->at = (self->at + 1) % WATCHED_CALLS;
    self->over_total += over;
    self->calm = over ? 0 : self->calm + 1;
    bool rested = end_ns - self->stage_ns >= in_ns(self->config.budget_stage_s);
    if (self->over_count >= self->config.budget_late_calls && rested && self->stage < BUDGET_LAND) {
        enter(self, self->stage + 1, end_ns);
        return true;
    }
    if (self->calm >= CALM_CALLS && self->stage > BUDGET_KEPT && self->stage < BUDGET_LAND) {
        enter(self, self->stage - 1, end_ns);
        return true;
    }
    return false;
}
