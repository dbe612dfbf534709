/* The messages between onboard and offboard, of the directions in which onboard sends and receives them, and the checks of
 * their values: the twin of protocol/messages.py. */
#ifndef DMRAC_MESSAGES_H
#define DMRAC_MESSAGES_H

#include <stdbool.h>
#include <stdint.h>

#include "estimation/readings.h"
#include "generated/constants.h"

/* u_hat or nu_ad of both channels. */
#define CHANNEL_VALUES 6
/* Bytes of the bitmap of a transfer's chunks. */
#define BITMAP_BYTES (CHUNK_COUNT_MAX / 8)

/* Up: consecutive samples. */
typedef struct {
    int64_t first_index;
    int64_t time_ns;
    int64_t period_ns;
    int64_t feature_version;
    int32_t count;
    float signals[SAMPLES_PER_BATCH_MAX * SIGNAL_COUNT];
    float delivered[SAMPLES_PER_BATCH_MAX * CHANNEL_VALUES];
    float adaptive[SAMPLES_PER_BATCH_MAX * CHANNEL_VALUES];
} SampleBatch;

/* Up: flight mode, feature versions, transfer and link of onboard. */
typedef struct {
    int64_t mode;
    int64_t feature_version;  /* in use; 0 for the random start features */
    int64_t transfer_version; /* being received; 0 for none */
    uint8_t received_chunks[BITMAP_BYTES];
    int32_t received_chunks_size; /* bytes of the bitmap that are sent */
    int64_t refused_version;      /* 0 for none */
    int64_t refusal;              /* a Refusal */
    int64_t ticks;
    int64_t missed_ticks;
    int64_t pose_age_ms; /* -1 before the first one */
    int64_t received;
    int64_t lost;
    int64_t rejected;
} Status;

/* Down: one piece of an encoded feature set. */
typedef struct {
    int64_t version;
    int32_t index;
    int32_t count;
    uint8_t digest[DIGEST_BYTES];
    uint8_t data[CHUNK_DATA_MAX_BYTES];
    int32_t size;
} FeatureChunk;

/* Down: protocol.messages.Pose. */
typedef struct {
    int64_t time_ns; /* when the vehicle had this pose, in the sender's clock */
    Pose pose;
} RelayedPose;

/* Up, and down as a challenge. */
typedef struct {
    int64_t origin_ns;
    uint8_t layout[LAYOUT_BYTES];
} TimeSyncRequest;

/* Down, and up as the answer to a challenge. */
typedef struct {
    int64_t origin_ns;
    int64_t receive_ns;
    int64_t transmit_ns;
    uint8_t layout[LAYOUT_BYTES];
} TimeSyncReply;

/* Whether every value is allowed. Those of chunk and pose are checked as they are read (codec.c). */
bool sample_batch_is_valid(const SampleBatch *self);
bool status_is_valid(const Status *self);
bool time_sync_reply_is_valid(const TimeSyncReply *self);

#endif
