#include "protocol/codec.h"

#include <math.h>
#include <string.h>

#include "protocol/little_endian.h"

/* --- what onboard sends --- */

/* codec._pack_sample_batch */
bool encode_sample_batch(const SampleBatch *message, MsgpackWriter *body) {
    if (!sample_batch_is_valid(message)) {
        return false;
    }
    msgpack_write_array(body, 7);
    msgpack_write_number(body, message->first_index);
    msgpack_write_number(body, message->time_ns);
    msgpack_write_number(body, message->period_ns);
    msgpack_write_number(body, message->feature_version);
    msgpack_write_floats(body, message->signals, message->count * SIGNAL_COUNT);
    msgpack_write_floats(body, message->delivered, message->count * CHANNEL_VALUES);
    msgpack_write_floats(body, message->adaptive, message->count * CHANNEL_VALUES);
    return !body->full;
}

bool encode_status(const Status *message, MsgpackWriter *body) {
    if (!status_is_valid(message)) {
        return false;
    }
    msgpack_write_array(body, 12);
    msgpack_write_number(body, message->mode);
    msgpack_write_number(body, message->feature_version);
    msgpack_write_number(body, message->transfer_version);
    msgpack_write_bytes(body, message->received_chunks, message->received_chunks_size);
    msgpack_write_number(body, message->refused_version);
    msgpack_write_number(body, message->refusal);
    msgpack_write_number(body, message->ticks);
    msgpack_write_number(body, message->missed_ticks);
    msgpack_write_number(body, message->pose_age_ms);
    msgpack_write_number(body, message->received);
    msgpack_write_number(body, message->lost);
    msgpack_write_number(body, message->rejected);
    return !body->full;
}

bool encode_time_sync_request(const TimeSyncRequest *message, MsgpackWriter *body) {
    if (message->origin_ns < 0) {
        return false;
    }
    msgpack_write_array(body, 2);
    msgpack_write_number(body, message->origin_ns);
    msgpack_write_bytes(body, message->layout, LAYOUT_BYTES);
    return !body->full;
}

bool encode_time_sync_reply(const TimeSyncReply *message, MsgpackWriter *body) {
    if (!time_sync_reply_is_valid(message)) {
        return false;
    }
    msgpack_write_array(body, 4);
    msgpack_write_number(body, message->origin_ns);
    msgpack_write_number(body, message->receive_ns);
    msgpack_write_number(body, message->transmit_ns);
    msgpack_write_bytes(body, message->layout, LAYOUT_BYTES);
    return !body->full;
}

/* --- what offboard sends --- */

static bool read_fields(const uint8_t *body, size_t size, const char *kinds, MsgpackField fields[FIELDS_MAX]) {
    return msgpack_read(body, size, kinds, CHUNK_DATA_MAX_BYTES, fields);
}

static Rejection decode_request(const uint8_t *body, size_t size, TimeSyncRequest *out) {
    MsgpackField fields[FIELDS_MAX];
    if (!read_fields(body, size, "ib", fields)) {
        return REJECTED_BODY;
    }
    if (fields[0].number < 0 || fields[1].size != LAYOUT_BYTES) {
        return REJECTED_VALUE;
    }
    out->origin_ns = fields[0].number;
    memcpy(out->layout, fields[1].bytes, LAYOUT_BYTES);
    return REJECTED_NONE;
}

static Rejection decode_reply(const uint8_t *body, size_t size, TimeSyncReply *out) {
    MsgpackField fields[FIELDS_MAX];
    if (!read_fields(body, size, "iiib", fields)) {
        return REJECTED_BODY;
    }
    if (fields[3].size != LAYOUT_BYTES) {
        return REJECTED_VALUE;
    }
    out->origin_ns = fields[0].number;
    out->receive_ns = fields[1].number;
    out->transmit_ns = fields[2].number;
    memcpy(out->layout, fields[3].bytes, LAYOUT_BYTES);
    return time_sync_reply_is_valid(out) ? REJECTED_NONE : REJECTED_VALUE;
}

/* FeatureChunk.__post_init__ as well */
static Rejection decode_chunk(const uint8_t *body, size_t size, FeatureChunk *out) {
    MsgpackField fields[FIELDS_MAX];
    if (!read_fields(body, size, "iiibb", fields)) {
        return REJECTED_BODY;
    }
    int64_t version = fields[0].number, index = fields[1].number, count = fields[2].number;
    if (version < 1 || version > VERSION_MAX || count < 1 || count > CHUNK_COUNT_MAX || index < 0 || index >= count ||
        fields[3].size != DIGEST_BYTES || fields[4].size < 1) {
        return REJECTED_VALUE;
    }
    out->version = version;
    out->index = (int32_t)index;
    out->count = (int32_t)count;
    memcpy(out->digest, fields[3].bytes, DIGEST_BYTES);
    memcpy(out->data, fields[4].bytes, (size_t)fields[4].size);
    out->size = fields[4].size;
    return REJECTED_NONE;
}

/* Pose.__post_init__: NaN fails every comparison. In double, as numpy's core computes. */
static bool pose_is_valid(int64_t time_ns, const float position[3], const float quaternion[4]) {
    double squares = 0.0;
    for (int i = 0; i < 3; i++) {
        if (!(fabsf(position[i]) <= (float)ABSOLUTE_VALUE_MAX)) {
            return false;
        }
    }
    for (int i = 0; i < 4; i++) {
        squares += (double)quaternion[i] * (double)quaternion[i];
    }
    return time_ns >= 0 && fabs(sqrt(squares) - 1.0) < 1e-3;
}

/* codec._unpack_pose */
static Rejection decode_pose(const uint8_t *body, size_t size, RelayedPose *out) {
    MsgpackField fields[FIELDS_MAX];
    float position[3], quaternion[4];
    if (!read_fields(body, size, "ibb", fields) || fields[1].size != 4 * 3 || fields[2].size != 4 * 4) {
        return REJECTED_BODY;
    }
    for (int i = 0; i < 3; i++) {
        position[i] = read_f32(fields[1].bytes + 4 * i);
        out->pose.position[i] = (real)position[i];
    }
    for (int i = 0; i < 4; i++) {
        quaternion[i] = read_f32(fields[2].bytes + 4 * i);
        out->pose.quaternion[i] = (real)quaternion[i];
    }
    out->time_ns = fields[0].number;
    return pose_is_valid(out->time_ns, position, quaternion) ? REJECTED_NONE : REJECTED_VALUE;
}

bool is_sent_down(int32_t type) {
    return type == MESSAGE_TIME_SYNC_REQUEST || type == MESSAGE_FEATURE_CHUNK || type == MESSAGE_POSE ||
           type == MESSAGE_TIME_SYNC_REPLY;
}

Rejection decode_body(int32_t type, const uint8_t *body, size_t size, Message *out) {
    out->type = (MessageType)type;
    switch (out->type) {
        case MESSAGE_TIME_SYNC_REQUEST:
            return decode_request(body, size, &out->request);
        case MESSAGE_FEATURE_CHUNK:
            return decode_chunk(body, size, &out->chunk);
        case MESSAGE_POSE:
            return decode_pose(body, size, &out->pose);
        case MESSAGE_TIME_SYNC_REPLY:
            return decode_reply(body, size, &out->reply);
        case MESSAGE_SAMPLE_BATCH:
        case MESSAGE_STATUS:
            break;
    }
    return REJECTED_TYPE;
}
