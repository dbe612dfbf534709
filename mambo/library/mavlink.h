/* MAVLink 2 frames of the few messages of the ground station, with signatures. The twin of protocol/mavlink/frames.py
 * and signing.py for these messages. */
#ifndef DMRAC_MAVLINK_H
#define DMRAC_MAVLINK_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define MAVLINK_KEY_BYTES 32
#define MAVLINK_PAYLOAD_MAX 64
#define MAVLINK_FRAME_MAX (10 + 255 + 2 + 13)
/* Sender, component and link of signed frames that are known at once; others are refused. */
#define MAVLINK_STREAMS_MAX 4
/* s, between a signature's time and ours. */
#define MAVLINK_TOLERANCE_S 60

typedef enum {
    MESSAGE_HEARTBEAT = 0,
    MESSAGE_SYS_STATUS = 1,
    MESSAGE_ATTITUDE_QUATERNION = 31,
    MESSAGE_LOCAL_POSITION = 32,
    MESSAGE_COMMAND_LONG = 76,
    MESSAGE_COMMAND_ACK = 77,
    MESSAGE_STATUSTEXT = 253
} MavlinkMessage;

typedef struct {
    bool used;
    uint8_t system, component, link;
    uint64_t newest; /* signature time, 10 us since 2015 */
} MavlinkStream;

typedef struct {
    uint8_t key[MAVLINK_KEY_BYTES];
    bool has_key;
    uint64_t start_time; /* signature time at start_ns */
    int64_t start_ns;
    uint64_t last_sent; /* the signature time of the last frame */
    uint8_t sequence;
    MavlinkStream streams[MAVLINK_STREAMS_MAX];
    int64_t refused;
} Mavlink;

/* A frame that was accepted. Bytes behind `size` are zero: the sender leaves out zeros at the end. */
typedef struct {
    uint32_t message;
    uint8_t system, component;
    uint8_t payload[MAVLINK_PAYLOAD_MAX];
} MavlinkFrame;

/* wall_ns: ns since 1970, for the signatures. key_size: MAVLINK_KEY_BYTES, or 0 for none. */
void mavlink_init(Mavlink *self, const uint8_t *key, int32_t key_size, int64_t wall_ns, int64_t now_ns);

/* A frame of a payload in the order of the wire; returns its bytes. */
size_t mavlink_write(Mavlink *self, MavlinkMessage message, const uint8_t *payload, size_t size, int64_t now_ns,
                     uint8_t out[MAVLINK_FRAME_MAX]);

/* The first frame of a datagram: a HEARTBEAT or COMMAND_LONG. False, and counted, if it is refused. */
bool mavlink_read(Mavlink *self, const uint8_t *datagram, size_t size, int64_t now_ns, MavlinkFrame *out);

#endif
