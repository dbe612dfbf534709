/* Onboard's end of the link, without I/O: turns messages into authenticated datagrams, and datagrams into messages. The
 * twin of protocol/endpoint.py in the role "onboard", which explains the order of the checks. */
#ifndef DMRAC_ENDPOINT_H
#define DMRAC_ENDPOINT_H

#include "protocol/authentication.h"
#include "protocol/clock.h"
#include "protocol/codec.h"
#include "protocol/session.h"
#include "protocol/statistics.h"

#define HEADER_BYTES (DATAGRAM_MAX_BYTES - BODY_MAX_BYTES - MAC_BYTES)

typedef struct {
    uint8_t bytes[DATAGRAM_MAX_BYTES];
    int32_t size;
} Datagram;

typedef struct {
    Authenticator sending;
    Authenticator receiving;
    uint64_t session;
    int32_t vehicle_id;
    uint64_t sequence;
    PeerSessions peer;
    ClockEstimate clock;
    bool has_began;
    int64_t began_ns; /* when this side began; not known any more after its own clock went back */
    bool has_latest;
    int64_t latest_ns;
    bool has_fastest;
    int64_t fastest_ns; /* least difference of arrival and sender time in this session of the peer */
    int64_t allowance_ns;
    bool allowance_started;
    int64_t allowance_at_ns;
    LinkStatistics statistics;
    uint8_t layout[LAYOUT_BYTES]; /* all zero: that of the peer is not compared */
    bool has_peer_layout;         /* this session of the peer has sent a time sync message */
    uint8_t peer_layout[LAYOUT_BYTES];
} Endpoint;

/* key_size: 16 to 64, or 0 for none. vehicle_id: 0 to 65535. False for others, and `self` must not be used then. */
bool endpoint_init(Endpoint *self, uint64_t session, const uint8_t *key, int32_t key_size, int32_t vehicle_id,
                   const uint8_t layout[LAYOUT_BYTES]);

/* Endpoint.encode: a message as a datagram with the next sequence number. False if a value is not allowed; then no number
 * is used. Time sync messages get our layout. */
bool endpoint_encode_sample_batch(Endpoint *self, const SampleBatch *message, int64_t now_ns, Datagram *out);
bool endpoint_encode_status(Endpoint *self, const Status *message, int64_t now_ns, Datagram *out);
bool endpoint_encode_request(Endpoint *self, int64_t origin_ns, int64_t now_ns, Datagram *out);
bool endpoint_encode_reply(Endpoint *self, int64_t origin_ns, int64_t receive_ns, int64_t transmit_ns, int64_t now_ns,
                           Datagram *out);

/* Decode a datagram of the peer. False if it was rejected, which is counted, or is a duplicate. */
bool endpoint_decode(Endpoint *self, const uint8_t *datagram, size_t size, int64_t now_ns, Message *out);

/* Endpoint.layout_mismatch: whether the peer's features or sample layout differ. */
bool endpoint_layout_differs(const Endpoint *self);

#endif
