#include "protocol/messages.h"

#include <math.h>

#define PERIOD_MAX_NS 1000000000

static bool is_version(int64_t number) {
    return 0 <= number && number <= VERSION_MAX;
}

/* _require_array: this form refuses NaN */
static bool are_numbers(const float *values, int32_t count) {
    for (int32_t i = 0; i < count; i++) {
        if (!(fabsf(values[i]) <= (float)ABSOLUTE_VALUE_MAX)) {
            return false;
        }
    }
    return true;
}

/* SampleBatch.__post_init__ */
bool sample_batch_is_valid(const SampleBatch *self) {
    int32_t n = self->count;
    return 1 <= n && n <= SAMPLES_PER_BATCH_MAX && self->first_index >= 0 && self->time_ns >= 0 &&
           is_version(self->feature_version) && 0 < self->period_ns && self->period_ns <= PERIOD_MAX_NS &&
           are_numbers(self->signals, n * SIGNAL_COUNT) && are_numbers(self->delivered, n * CHANNEL_VALUES) &&
           are_numbers(self->adaptive, n * CHANNEL_VALUES);
}

/* Status.__post_init__ */
bool status_is_valid(const Status *self) {
    bool numbers = 0 <= self->mode && self->mode < MODES && is_version(self->feature_version) &&
                   is_version(self->transfer_version) && is_version(self->refused_version) && 0 <= self->refusal &&
                   self->refusal < REFUSAL_COUNT;
    bool counters =
        self->ticks >= 0 && self->missed_ticks >= 0 && self->received >= 0 && self->lost >= 0 && self->rejected >= 0;
    return numbers && counters && 0 <= self->received_chunks_size && self->received_chunks_size <= BITMAP_BYTES &&
           -1 <= self->pose_age_ms && self->pose_age_ms <= UINT32_MAX;
}

/* TimeSyncReply.__post_init__ */
bool time_sync_reply_is_valid(const TimeSyncReply *self) {
    return self->origin_ns >= 0 && self->receive_ns >= 0 && self->transmit_ns >= self->receive_ns;
}
