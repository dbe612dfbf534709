/* Makes sample batches for offboard from ticks, within a byte budget: the twin of onboard/sampling/sampler.py. */
#ifndef DMRAC_SAMPLER_H
#define DMRAC_SAMPLER_H

#include <stdbool.h>

#include "generated/config.h"
#include "protocol/messages.h"

/* Batches of one poll: a burst of the budget holds no more, even of one sample each. */
#define BATCHES_MAX 10
/* Batches that wait to be sent a second time; the oldest is left out if there are more. numpy's core has no limit. */
#define REPEATS_MAX 256

typedef struct {
    int64_t index;
    int64_t time_ns;
    int64_t version; /* -1: not known yet */
    float signals[SIGNAL_COUNT];
    float delivered[CHANNEL_VALUES];
    float adaptive[CHANNEL_VALUES];
} Sample;

typedef struct {
    int64_t due_ns;
    SampleBatch batch;
} Repeat;

typedef struct {
    SamplerConfig config;
    int64_t period_ns;
    int64_t repeat_after_ns;
    Sample waiting[KEPT_SAMPLES_MAX]; /* a ring */
    int32_t waiting_first;
    int32_t waiting_count;
    real sum[CHANNEL_VALUES];
    int32_t ticks;
    bool started;
    int64_t start_ns;
    int64_t due_ns;
    int64_t pushed_ns;
    double allowance_bytes; /* a double in the float core too: a batch is due to the byte */
    bool refilled;
    int64_t refilled_ns;
    Repeat repeats[REPEATS_MAX]; /* a ring */
    int32_t repeats_first;
    int32_t repeats_count;
    int64_t taken;    /* samples since start */
    int64_t dropped;  /* because the budget did not suffice */
    int64_t repeated; /* sent a second time */
} SampleQueue;

void sampler_init(SampleQueue *self, const SamplerConfig *config);

/* Add one tick; u_hat and nu_ad [2, 3] of position and attitude. */
void sampler_push(SampleQueue *self, int64_t time_ns, const real signals[SIGNAL_COUNT],
                  const real u_hat[CHANNEL_VALUES], const real nu_ad[CHANNEL_VALUES]);

/* The batches to send now: their number, at most BATCHES_MAX. `feature_version`: in use for the samples taken since the
 * last poll. `loss`: share of datagrams that the link loses. */
int32_t sampler_poll(SampleQueue *self, int64_t now_ns, int64_t feature_version, real loss, SampleBatch *batches);

/* Take a datagram that is not a batch (status, time sync) from the budget. It is sent in any case. */
void sampler_charge(SampleQueue *self, int32_t datagram_bytes, int64_t now_ns);

#endif
