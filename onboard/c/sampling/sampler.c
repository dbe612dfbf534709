#include "sampling/sampler.h"

#include <string.h>

#include "numerics/elementary.h"
#include "numerics/whole.h"

/* SampleQueue.__init__ */
void sampler_init(SampleQueue *self, const SamplerConfig *config) {
    memset(self, 0, sizeof *self);
    self->config = *config;
    self->period_ns = (int64_t)(1e9 / (double)config->rate_hz + 0.5);
    self->repeat_after_ns = nanoseconds_nearest(config->repeat_after_s);
    self->allowance_bytes = (double)BURST_BYTES;
}

/* The sample `index` places behind the oldest that waits. */
static Sample *waiting(SampleQueue *self, int32_t index) {
    return self->waiting + (self->waiting_first + index) % self->config.kept_samples;
}

static void drop_oldest(SampleQueue *self) {
    self->waiting_first = (self->waiting_first + 1) % self->config.kept_samples;
    self->waiting_count--;
}

static void clear_mean(SampleQueue *self) {
    memset(self->sum, 0, sizeof self->sum);
    self->ticks = 0;
}

/* SampleQueue._take */
static void take(SampleQueue *self, int64_t index, int64_t time_ns, const real signals[SIGNAL_COUNT],
                 const real nu_ad[CHANNEL_VALUES]) {
    if (self->waiting_count == self->config.kept_samples) {
        self->dropped++;
        drop_oldest(self);
    }
    Sample *sample = waiting(self, self->waiting_count++);
    sample->index = index;
    sample->time_ns = time_ns;
    sample->version = -1;
    for (int i = 0; i < SIGNAL_COUNT; i++) {
        sample->signals[i] = (float)signals[i];
    }
    for (int i = 0; i < CHANNEL_VALUES; i++) {
        sample->delivered[i] = (float)(self->sum[i] / (real)self->ticks);
        sample->adaptive[i] = (float)nu_ad[i];
    }
    clear_mean(self);
    self->taken++;
}

/* SampleQueue.push */
void sampler_push(SampleQueue *self, int64_t time_ns, const real signals[SIGNAL_COUNT],
                  const real u_hat[CHANNEL_VALUES], const real nu_ad[CHANNEL_VALUES]) {
    if (!self->started) {
        self->started = true;
        self->start_ns = self->due_ns = time_ns;
    } else if (time_ns - self->pushed_ns > self->period_ns) { /* a pause: no mean spans it */
        clear_mean(self);
    }
    self->pushed_ns = time_ns;
    for (int i = 0; i < CHANNEL_VALUES; i++) {
        self->sum[i] += u_hat[i];
    }
    self->ticks++;
    if (time_ns < self->due_ns) {
        return;
    }
    int64_t place = (time_ns - self->start_ns) / self->period_ns;
    self->due_ns = self->start_ns + (place + 1) * self->period_ns;
    take(self, place, time_ns, signals, nu_ad);
}

/* _cost_bytes */
static double cost_bytes(int32_t samples) {
    return (double)(BATCH_OVERHEAD_BYTES + samples * SAMPLE_BYTES);
}

/* SampleQueue._refill */
static void refill(SampleQueue *self, int64_t now_ns) {
    int64_t since_ns = self->refilled && now_ns > self->refilled_ns ? now_ns - self->refilled_ns : 0;
    self->refilled = true;
    self->refilled_ns = now_ns;
    double earned = (double)since_ns * 1e-9 * (double)self->config.budget_bytes_s;
    self->allowance_bytes += earned;
    if (self->allowance_bytes > (double)BURST_BYTES) {
        self->allowance_bytes = (double)BURST_BYTES;
    }
}

/* SampleQueue._ready_run: length of the next batch: full, ended by a gap or a new version, or overdue; 0 to wait */
static int32_t ready_run(SampleQueue *self, int64_t now_ns) {
    if (self->waiting_count == 0) {
        return 0;
    }
    const Sample *head = waiting(self, 0);
    int32_t most = self->config.batch_samples, run = 0;
    for (; run < self->waiting_count; run++) {
        const Sample *sample = waiting(self, run);
        if (run == most || sample->index != head->index + run || sample->version != head->version) {
            return run;
        }
    }
    bool overdue = now_ns - head->time_ns > (most + 1) * self->period_ns;
    return run == most || overdue ? run : 0;
}

/* SampleQueue._batch: takes the oldest `run` samples */
static void make_batch(SampleQueue *self, int32_t run, SampleBatch *batch) {
    const Sample *first = waiting(self, 0);
    batch->first_index = first->index;
    batch->time_ns = first->time_ns;
    batch->period_ns = self->period_ns;
    batch->feature_version = first->version;
    batch->count = run;
    for (int32_t i = 0; i < run; i++) {
        const Sample *sample = waiting(self, 0);
        memcpy(batch->signals + i * SIGNAL_COUNT, sample->signals, sizeof sample->signals);
        memcpy(batch->delivered + i * CHANNEL_VALUES, sample->delivered, sizeof sample->delivered);
        memcpy(batch->adaptive + i * CHANNEL_VALUES, sample->adaptive, sizeof sample->adaptive);
        drop_oldest(self);
    }
}

static void repeat_later(SampleQueue *self, const SampleBatch *batch, int64_t due_ns) {
    if (self->repeats_count == REPEATS_MAX) {
        self->repeats_first = (self->repeats_first + 1) % REPEATS_MAX;
        self->repeats_count--;
    }
    Repeat *repeat = self->repeats + (self->repeats_first + self->repeats_count++) % REPEATS_MAX;
    repeat->due_ns = due_ns;
    repeat->batch = *batch;
}

/* SampleQueue._due_repeats: as long as the budget has room for a batch of new samples as well */
static int32_t due_repeats(SampleQueue *self, int64_t now_ns, SampleBatch *batches, int32_t count) {
    double new_bytes = cost_bytes(self->config.batch_samples);
    while (self->repeats_count > 0 && self->repeats[self->repeats_first].due_ns <= now_ns) {
        const SampleBatch *batch = &self->repeats[self->repeats_first].batch;
        double cost = cost_bytes(batch->count);
        if (cost + new_bytes <= self->allowance_bytes && count < BATCHES_MAX) {
            self->allowance_bytes -= cost;
            self->repeated += batch->count;
            batches[count++] = *batch;
        }
        self->repeats_first = (self->repeats_first + 1) % REPEATS_MAX;
        self->repeats_count--;
    }
    return count;
}

/* SampleQueue.poll */
int32_t sampler_poll(SampleQueue *self, int64_t now_ns, int64_t feature_version, real loss, SampleBatch *batches) {
    if (self->waiting_count == 0 && self->repeats_count == 0) {
        return 0;
    }
    for (int32_t i = self->waiting_count - 1; i >= 0 && waiting(self, i)->version < 0; i--) {
        waiting(self, i)->version = feature_version;
    }
    refill(self, now_ns);
    bool repeat = self->config.repeat_from_loss <= loss && loss < REAL(1.0);
    int32_t count = 0, run;
    while (count < BATCHES_MAX && (run = ready_run(self, now_ns)) > 0) {
        double cost = cost_bytes(run);
        if (cost > self->allowance_bytes) {
            break;
        }
        self->allowance_bytes -= cost;
        make_batch(self, run, batches + count);
        if (repeat) {
            repeat_later(self, batches + count, now_ns + self->repeat_after_ns);
        }
        count++;
    }
    return due_repeats(self, now_ns, batches, count);
}

/* SampleQueue.charge */
void sampler_charge(SampleQueue *self, int32_t datagram_bytes, int64_t now_ns) {
    refill(self, now_ns);
    self->allowance_bytes -= (double)(datagram_bytes + NETWORK_BYTES);
}
