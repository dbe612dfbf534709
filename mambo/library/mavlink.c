#include "mavlink.h"

#include <string.h>

#include "sha256.h"

#define MARKER 0xfd
#define HEADER 10
#define CHECKSUM 2
#define SIGNATURE 13
#define SIGNED 1
#define OWN_SYSTEM 1
#define OWN_COMPONENT 1
/* 2015-01-01, s since 1970. */
#define EPOCH_S INT64_C(1420070400)
#define UNITS_PER_S 100000

void mavlink_init(Mavlink *self, const uint8_t *key, int32_t key_size, int64_t wall_ns, int64_t now_ns) {
    memset(self, 0, sizeof *self);
    self->has_key = key_size == MAVLINK_KEY_BYTES;
    if (self->has_key) {
        memcpy(self->key, key, sizeof self->key);
    }
    int64_t units = (wall_ns - EPOCH_S * INT64_C(1000000000)) / 10000;
    self->start_time = units > 0 ? (uint64_t)units : 0;
    self->start_ns = now_ns;
}

static uint64_t signature_time(const Mavlink *self, int64_t now_ns) {
    return self->start_time + (uint64_t)((now_ns - self->start_ns) / 10000);
}

/* What the checksum of a message ends with; -1 for a message that is not known. */
static int extra_of(uint32_t message) {
    switch (message) {
        case MESSAGE_HEARTBEAT:
            return 50;
        case MESSAGE_SYS_STATUS:
            return 124;
        case MESSAGE_ATTITUDE_QUATERNION:
            return 246;
        case MESSAGE_LOCAL_POSITION:
            return 185;
        case MESSAGE_COMMAND_LONG:
            return 152;
        case MESSAGE_COMMAND_ACK:
            return 143;
        case MESSAGE_STATUSTEXT:
            return 83;
        default:
            return -1;
    }
}

/* CRC-16/MCRF4XX of the bytes and of `extra`. */
static uint16_t checksum(const uint8_t *bytes, size_t size, uint8_t extra) {
    unsigned crc = 0xffff;
    for (size_t i = 0; i <= size; i++) {
        unsigned x = ((i < size ? bytes[i] : extra) ^ crc) & 0xff;
        x = (x ^ x << 4) & 0xff;
        crc = crc >> 8 ^ x << 8 ^ x << 3 ^ x >> 4;
    }
    return (uint16_t)crc;
}

/* The 6 bytes of the signature of a frame, of `size` bytes with its link id and time. */
static void sign(const Mavlink *self, const uint8_t *frame, size_t size, uint8_t out[6]) {
    uint8_t digest[SHA256_BYTES];
    Sha256 hash;
    sha256_start(&hash);
    sha256_add(&hash, self->key, sizeof self->key);
    sha256_add(&hash, frame, size);
    sha256_finish(&hash, digest);
    memcpy(out, digest, 6);
}

size_t mavlink_write(Mavlink *self, MavlinkMessage message, const uint8_t *payload, size_t size, int64_t now_ns,
                     uint8_t out[MAVLINK_FRAME_MAX]) {
    while (size > 1 && payload[size - 1] == 0) {
        size--;
    }
    const uint8_t header[HEADER] = {MARKER,     (uint8_t)size, self->has_key ? SIGNED : 0, 0, self->sequence++,
                                    OWN_SYSTEM, OWN_COMPONENT, (uint8_t)message,           0, 0};
    memcpy(out, header, HEADER);
    memcpy(out + HEADER, payload, size);
    uint16_t crc = checksum(out + 1, HEADER - 1 + size, (uint8_t)extra_of(message));
    size_t end = HEADER + size;
    out[end++] = (uint8_t)(crc & 0xff);
    out[end++] = (uint8_t)(crc >> 8);
    if (!self->has_key) {
        return end;
    }
    uint64_t time = signature_time(self, now_ns);
    time = time > self->last_sent ? time : self->last_sent + 1; /* each is newer than the one before */
    self->last_sent = time;
    out[end++] = 0; /* link id */
    for (int i = 0; i < 6; i++) {
        out[end++] = (uint8_t)(time >> (8 * i));
    }
    sign(self, out, end, out + end);
    return end + 6;
}

/* --- receive --- */

static MavlinkStream *stream_of(Mavlink *self, const uint8_t *frame, uint8_t link) {
    for (int i = 0; i < MAVLINK_STREAMS_MAX; i++) {
        MavlinkStream *one = self->streams + i;
        if (!one->used || (one->system == frame[5] && one->component == frame[6] && one->link == link)) {
            return one;
        }
    }
    return NULL;
}

/* Verified first, stored then: a forged frame changes nothing. */
static bool is_genuine(Mavlink *self, const uint8_t *frame, size_t signed_at, int64_t now_ns) {
    const uint8_t *signature = frame + signed_at;
    uint8_t expected[6], difference = 0;
    uint64_t time = 0, own = signature_time(self, now_ns), tolerance = (uint64_t)MAVLINK_TOLERANCE_S * UNITS_PER_S;
    sign(self, frame, signed_at + 7, expected);
    for (int i = 0; i < 6; i++) {
        difference |= (uint8_t)(expected[i] ^ signature[7 + i]);
        time |= (uint64_t)signature[1 + i] << (8 * i);
    }
    MavlinkStream *stream = stream_of(self, frame, signature[0]);
    if (difference || !stream || time > own + tolerance || time + tolerance < own || time <= stream->newest) {
        return false;
    }
    *stream = (MavlinkStream){true, frame[5], frame[6], signature[0], time};
    return true;
}

static bool check(Mavlink *self, const uint8_t *frame, size_t size, int64_t now_ns) {
    if (size < HEADER + CHECKSUM || frame[0] != MARKER || (frame[2] & ~SIGNED) != 0 || frame[5] == OWN_SYSTEM) {
        return false;
    }
    uint32_t message = (uint32_t)frame[7] | (uint32_t)frame[8] << 8 | (uint32_t)frame[9] << 16;
    size_t payload = frame[1], end = HEADER + payload;
    bool has_signature = (frame[2] & SIGNED) != 0;
    if (size < end + CHECKSUM + (has_signature ? SIGNATURE : 0) || payload > MAVLINK_PAYLOAD_MAX ||
        (message != MESSAGE_HEARTBEAT && message != MESSAGE_COMMAND_LONG)) {
        return false;
    }
    uint16_t crc = checksum(frame + 1, end - 1, (uint8_t)extra_of(message));
    if (frame[end] != (crc & 0xff) || frame[end + 1] != crc >> 8) {
        return false;
    }
    return !self->has_key || (has_signature && is_genuine(self, frame, end + CHECKSUM, now_ns));
}

bool mavlink_read(Mavlink *self, const uint8_t *datagram, size_t size, int64_t now_ns, MavlinkFrame *out) {
    if (!check(self, datagram, size, now_ns)) {
        self->refused++;
        return false;
    }
    memset(out, 0, sizeof *out);
    out->message = (uint32_t)datagram[7] | (uint32_t)datagram[8] << 8 | (uint32_t)datagram[9] << 16;
    out->system = datagram[5];
    out->component = datagram[6];
    memcpy(out->payload, datagram + HEADER, datagram[1]);
    return true;
}
