#include "protocol/endpoint.h"

#include <string.h>

#include "numerics/whole.h"
#include "protocol/little_endian.h"

#define DATAGRAM_COST_NS (1000000000 / RATE_MAX_HZ)
#define ALLOWANCE_MAX_NS (RATE_BURST * DATAGRAM_COST_NS)
#define VEHICLE_ID_MAX 65535

/* What the header says, but version, type and vehicle id. */
typedef struct {
    int32_t type;
    uint64_t session;
    uint64_t sequence;
    uint64_t sent_ns;
} Header;

/* Endpoint.__init__ */
bool endpoint_init(Endpoint *self, uint64_t session, const uint8_t *key, int32_t key_size, int32_t vehicle_id,
                   const uint8_t layout[LAYOUT_BYTES]) {
    memset(self, 0, sizeof *self);
    self->session = session;
    self->vehicle_id = vehicle_id;
    peer_sessions_init(&self->peer);
    clock_estimate_init(&self->clock);
    link_statistics_init(&self->statistics);
    self->allowance_ns = ALLOWANCE_MAX_NS;
    memcpy(self->layout, layout, LAYOUT_BYTES);
    return 0 <= vehicle_id && vehicle_id <= VEHICLE_ID_MAX &&
           authenticator_init(&self->sending, key, key_size, DIRECTION_UP) &&
           authenticator_init(&self->receiving, key, key_size, DIRECTION_DOWN);
}

static bool expects_layout(const Endpoint *self) {
    static const uint8_t none[LAYOUT_BYTES] = {0};
    return memcmp(self->layout, none, LAYOUT_BYTES) != 0;
}

static bool has_our_layout(const Endpoint *self) {
    return self->has_peer_layout && memcmp(self->layout, self->peer_layout, LAYOUT_BYTES) == 0;
}

bool endpoint_layout_differs(const Endpoint *self) {
    return self->has_peer_layout && expects_layout(self) && !has_our_layout(self);
}

/* Endpoint._note_time */
static void note_time(Endpoint *self, int64_t now_ns) {
    if (!self->has_latest) {
        self->has_began = true;
        self->began_ns = now_ns;
    } else if (now_ns < self->latest_ns) {
        self->has_began = false;
    }
    self->has_latest = true;
    self->latest_ns = now_ns;
}

/* --- sending --- */

static MsgpackWriter body_of(Endpoint *self, int64_t now_ns, Datagram *out) {
    note_time(self, now_ns);
    return (MsgpackWriter){out->bytes + HEADER_BYTES, BODY_MAX_BYTES, 0, false};
}

/* The end of Endpoint.encode: header and MAC around the body that was written */
static bool seal(Endpoint *self, MessageType type, const MsgpackWriter *body, int64_t now_ns, Datagram *out) {
    int32_t size = HEADER_BYTES + body->size;
    out->bytes[0] = PROTOCOL_VERSION;
    out->bytes[1] = (uint8_t)type;
    out->bytes[2] = (uint8_t)(self->vehicle_id & 0xff);
    out->bytes[3] = (uint8_t)(self->vehicle_id >> 8);
    write_u64(out->bytes + 4, self->session);
    write_u64(out->bytes + 12, self->sequence);
    write_u64(out->bytes + 20, (uint64_t)now_ns);
    authenticator_mac(&self->sending, out->bytes, (size_t)size, out->bytes + size);
    out->size = size + MAC_BYTES;
    self->sequence++;
    self->statistics.sent++;
    self->statistics.sent_bytes += out->size;
    return true;
}

bool endpoint_encode_sample_batch(Endpoint *self, const SampleBatch *message, int64_t now_ns, Datagram *out) {
    MsgpackWriter body = body_of(self, now_ns, out);
    return encode_sample_batch(message, &body) && seal(self, MESSAGE_SAMPLE_BATCH, &body, now_ns, out);
}

bool endpoint_encode_status(Endpoint *self, const Status *message, int64_t now_ns, Datagram *out) {
    MsgpackWriter body = body_of(self, now_ns, out);
    return encode_status(message, &body) && seal(self, MESSAGE_STATUS, &body, now_ns, out);
}

bool endpoint_encode_request(Endpoint *self, int64_t origin_ns, int64_t now_ns, Datagram *out) {
    MsgpackWriter body = body_of(self, now_ns, out);
    TimeSyncRequest message = {origin_ns, {0}};
    memcpy(message.layout, self->layout, LAYOUT_BYTES);
    if (!encode_time_sync_request(&message, &body)) {
        return false;
    }
    clock_estimate_note_request(&self->clock, origin_ns);
    return seal(self, MESSAGE_TIME_SYNC_REQUEST, &body, now_ns, out);
}

bool endpoint_encode_reply(Endpoint *self, int64_t origin_ns, int64_t receive_ns, int64_t transmit_ns, int64_t now_ns,
                           Datagram *out) {
    MsgpackWriter body = body_of(self, now_ns, out);
    TimeSyncReply message = {origin_ns, receive_ns, transmit_ns, {0}};
    memcpy(message.layout, self->layout, LAYOUT_BYTES);
    return encode_time_sync_reply(&message, &body) && seal(self, MESSAGE_TIME_SYNC_REPLY, &body, now_ns, out);
}

/* --- receiving --- */

/* The checks of Endpoint._decode up to the MAC */
static Rejection check_header(const Endpoint *self, const uint8_t *datagram, size_t size, Header *out) {
    if (size < DATAGRAM_MIN_BYTES || size > DATAGRAM_MAX_BYTES) {
        return REJECTED_LENGTH;
    }
    if (datagram[0] != PROTOCOL_VERSION) {
        return REJECTED_VERSION;
    }
    if (!is_sent_down(datagram[1])) {
        return REJECTED_TYPE;
    }
    if ((datagram[2] | datagram[3] << 8) != self->vehicle_id) {
        return REJECTED_VEHICLE;
    }
    if (!authenticator_is_genuine(&self->receiving, datagram, size)) {
        return REJECTED_MAC;
    }
    *out = (Header){datagram[1], read_u64(datagram + 4), read_u64(datagram + 12), read_u64(datagram + 20)};
    return REJECTED_NONE;
}

/* Endpoint._answers_request: rule 3 of protocol/session.py. REJECTED_SESSION if it does not. */
static Rejection answers_request(const Endpoint *self, const Header *header, const uint8_t *body, size_t size,
                                 int64_t now_ns, Message *out) {
    if (header->type != MESSAGE_TIME_SYNC_REPLY ||
        !link_statistics_is_silent(&self->statistics, SILENCE_BEFORE_OLDER_NS, now_ns)) {
        return REJECTED_SESSION;
    }
    Rejection rejection = decode_body(header->type, body, size, out);
    if (rejection != REJECTED_NONE) {
        return rejection;
    }
    bool answers = clock_estimate_is_open(&self->clock, out->reply.origin_ns, now_ns) &&
                   peer_sessions_may_return(&self->peer, header->session);
    return answers ? REJECTED_NONE : REJECTED_SESSION;
}

/* Endpoint._start_session */
static void start_session(Endpoint *self, const Header *header) {
    peer_sessions_start(&self->peer, header->session, header->sequence);
    clock_estimate_restart(&self->clock);
    self->has_fastest = self->has_peer_layout = false;
    self->statistics.sessions++;
}

/* Session and sequence: what Endpoint._decode does between the MAC and `_count` */
static Rejection accept_session(Endpoint *self, const Header *header, const uint8_t *body, size_t size, int64_t now_ns,
                                Message *out) {
    if (self->peer.started && header->session == self->peer.current) {
        return replay_window_verdict(&self->peer.window, header->sequence);
    }
    if (!peer_sessions_is_newer(&self->peer, header->session)) {
        Rejection rejection = answers_request(self, header, body, size, now_ns, out);
        if (rejection != REJECTED_NONE) {
            return rejection;
        }
    }
    start_session(self, header);
    return REJECTED_NONE;
}

/* Endpoint._require_time */
static bool fits_time(const Endpoint *self, uint64_t sent_ns, int64_t now_ns) {
    if (sent_ns > (uint64_t)COUNTER_MAX) {
        return false;
    }
    return !self->has_fastest ||
           whole_difference((int64_t)sent_ns, now_ns) <= whole_difference(PEER_AHEAD_MAX_NS, self->fastest_ns);
}

/* Endpoint._is_of_before */
static bool is_of_before(const Endpoint *self, int64_t sent_ns) {
    const ClockExchange *best = &self->clock.best;
    if (!clock_estimate_is_known(&self->clock) || !self->has_began) {
        return false;
    }
    return whole_sum(whole_difference(sent_ns, best->offset_ns), best->round_trip_ns / 2) < self->began_ns;
}

/* Endpoint._count */
static void count(Endpoint *self, const Header *header, size_t size, int64_t now_ns) {
    self->statistics.reordered += replay_window_accept(&self->peer.window, header->sequence);
    self->statistics.lost = peer_sessions_lost(&self->peer);
    int64_t apart_ns = whole_difference(now_ns, (int64_t)header->sent_ns);
    self->fastest_ns = self->has_fastest ? whole_min(self->fastest_ns, apart_ns) : apart_ns;
    self->has_fastest = true;
    int64_t delay_ns = clock_estimate_is_known(&self->clock)
                           ? whole_max(0, whole_sum(apart_ns, self->clock.best.offset_ns))
                           : whole_difference(apart_ns, self->fastest_ns);
    link_statistics_count_received(&self->statistics, size, delay_ns, now_ns);
}

/* Endpoint._spend_allowance */
static bool spend_allowance(Endpoint *self, int64_t now_ns) {
    int64_t since_ns = self->allowance_started ? whole_max(0, now_ns - self->allowance_at_ns) : 0;
    self->allowance_started = true;
    self->allowance_at_ns = now_ns;
    self->allowance_ns = whole_min(ALLOWANCE_MAX_NS, whole_sum(self->allowance_ns, since_ns));
    if (self->allowance_ns < DATAGRAM_COST_NS) {
        return false;
    }
    self->allowance_ns -= DATAGRAM_COST_NS;
    return true;
}

/* The end of Endpoint._decode: what a message means to the endpoint itself */
static Rejection use(Endpoint *self, const Message *message, int64_t sent_ns, int64_t now_ns) {
    const TimeSyncReply *reply = &message->reply;
    bool request = message->type == MESSAGE_TIME_SYNC_REQUEST;
    if (message->type == MESSAGE_POSE) {
        int64_t apart_ns = whole_difference(sent_ns, message->pose.time_ns);
        if (apart_ns > APART_MAX_NS || apart_ns < -APART_MAX_NS) {
            return REJECTED_VALUE;
        }
    }
    if (request || message->type == MESSAGE_TIME_SYNC_REPLY) {
        self->has_peer_layout = true;
        memcpy(self->peer_layout, request ? message->request.layout : reply->layout, LAYOUT_BYTES);
    } else if (is_of_before(self, sent_ns)) {
        return REJECTED_BEFORE_START;
    } else if (message->type == MESSAGE_FEATURE_CHUNK && expects_layout(self) && !has_our_layout(self)) {
        return REJECTED_LAYOUT;
    }
    if (message->type == MESSAGE_TIME_SYNC_REPLY &&
        !clock_estimate_receive_reply(&self->clock, reply->origin_ns, reply->receive_ns, reply->transmit_ns, now_ns)) {
        return REJECTED_TIME_SYNC;
    }
    return REJECTED_NONE;
}

/* Endpoint._decode */
static Rejection decode(Endpoint *self, const uint8_t *datagram, size_t size, int64_t now_ns, Message *out) {
    Header header;
    Rejection rejection = check_header(self, datagram, size, &header);
    if (rejection != REJECTED_NONE) {
        return rejection;
    }
    const uint8_t *body = datagram + HEADER_BYTES;
    size_t body_size = size - HEADER_BYTES - MAC_BYTES;
    rejection = accept_session(self, &header, body, body_size, now_ns, out);
    if (rejection != REJECTED_NONE) {
        return rejection;
    }
    if (!fits_time(self, header.sent_ns, now_ns)) {
        return REJECTED_VALUE;
    }
    count(self, &header, size, now_ns);
    if (!spend_allowance(self, now_ns)) {
        return REJECTED_RATE;
    }
    rejection = decode_body(header.type, body, body_size, out);
    return rejection != REJECTED_NONE ? rejection : use(self, out, (int64_t)header.sent_ns, now_ns);
}

/* Endpoint.decode */
bool endpoint_decode(Endpoint *self, const uint8_t *datagram, size_t size, int64_t now_ns, Message *out) {
    note_time(self, now_ns);
    Rejection rejection = decode(self, datagram, size, now_ns, out);
    if (rejection == REJECTED_DUPLICATE) {
        self->statistics.duplicate++;
    } else if (rejection != REJECTED_NONE) {
        self->statistics.rejected[rejection]++;
    }
    return rejection == REJECTED_NONE;
}
