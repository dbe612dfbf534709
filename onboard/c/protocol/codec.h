/* The bytes of a message's body, as docs/protocol.md specifies them: the twin of protocol/codec.py. Encodes what onboard
 * sends and decodes what it receives. */
#ifndef DMRAC_CODEC_H
#define DMRAC_CODEC_H

#include "protocol/messages.h"
#include "protocol/msgpack_array.h"

/* The numbers of the messages on the wire. */
typedef enum {
    MESSAGE_SAMPLE_BATCH = 1,
    MESSAGE_STATUS = 2,
    MESSAGE_TIME_SYNC_REQUEST = 3,
    MESSAGE_FEATURE_CHUNK = 65,
    MESSAGE_POSE = 66,
    MESSAGE_TIME_SYNC_REPLY = 67
} MessageType;

/* A message of offboard: the member of its type. */
typedef struct {
    MessageType type;
    TimeSyncRequest request;
    FeatureChunk chunk;
    RelayedPose pose;
    TimeSyncReply reply;
} Message;

/* codec.encode_body. False, and nothing of use is written, if a value is not allowed or there is no room. */
bool encode_sample_batch(const SampleBatch *message, MsgpackWriter *body);
bool encode_status(const Status *message, MsgpackWriter *body);
bool encode_time_sync_request(const TimeSyncRequest *message, MsgpackWriter *body);
bool encode_time_sync_reply(const TimeSyncReply *message, MsgpackWriter *body);

/* Whether offboard sends messages of this type. */
bool is_sent_down(int32_t type);

/* The message of a body. `type`: one that offboard sends. Returns REJECTED_NONE, REJECTED_BODY (not the array of the type)
 * or REJECTED_VALUE (a value that is not allowed); `out` is of use only after the first. */
Rejection decode_body(int32_t type, const uint8_t *body, size_t size, Message *out);

#endif
