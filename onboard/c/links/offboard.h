/* The link to offboard: poses, feature chunks and challenges in; samples, status and time sync out. The twin of
 * onboard/links/offboard.py. Texts stay outside: onboard/c/event_text.py makes numpy's text of an event. */
#ifndef DMRAC_OFFBOARD_LINK_H
#define DMRAC_OFFBOARD_LINK_H

#include "generated/config.h"
#include "links/loss_rate.h"
#include "protocol/endpoint.h"

/* Events that wait to be taken; those beyond are lost and counted. */
#define LINK_EVENTS_MAX 16
/* Datagrams of one call of offboard_link_time_sync. */
#define SYNC_DATAGRAMS_MAX 2

/* A pose and its times in the onboard clock. */
typedef struct {
    Pose pose;
    int64_t taken_ns;
    int64_t arrival_ns;
    real time_sigma_s; /* standard deviation of `taken_ns` on a slow link; 0 on a fast one */
} DatedPose;

/* The content of one datagram for the other blocks, in this order. */
typedef struct {
    bool peer_restarted; /* a new session of offboard: its versions may start at 1 again */
    bool has_pose;
    DatedPose pose;
    bool has_chunk;
    FeatureChunk chunk;
} Received;

typedef enum {
    LINK_PEER_RESTARTED,
    LINK_LAYOUT_DIFFERS /* `peer_layout` and `layout` */
} LinkEventKind;

typedef struct {
    int64_t time_ns;
    LinkEventKind kind;
    uint8_t peer_layout[LAYOUT_BYTES];
    uint8_t layout[LAYOUT_BYTES];
} LinkEvent;

typedef struct {
    Endpoint endpoint;
    int64_t status_period_ns;
    int64_t sync_period_ns;
    LossRate loss;
    LinkEvent events[LINK_EVENTS_MAX];
    int32_t event_count;
    int32_t events_lost;
    bool has_peer_session;
    uint64_t peer_session;
    bool has_reported_session;
    uint64_t reported_session;
    bool challenged;
    int64_t challenge_origin_ns;
    int64_t challenge_receive_ns;
    int64_t next_status_ns;
    int64_t next_sync_ns;
    int64_t asked_ns;
    int64_t answered_ns;
    int64_t next_clock_record_ns;
    int64_t last_received_ns;
} OffboardLink;

/* session: number of this run, larger at each start. key_size: 16 to 64 bytes, or 0 for none, between loopback addresses
 * only. False for another one, and `self` must not be used then. */
bool offboard_link_init(OffboardLink *self, const CoreConfig *config, uint64_t session, const uint8_t *key,
                        int32_t key_size);

/* The content of one datagram, of any bytes; nothing for one that is not accepted. */
void offboard_link_receive(OffboardLink *self, const uint8_t *datagram, size_t size, int64_t now_ns, Received *out);

/* Copy the events since the last call and forget them; returns their number, at most LINK_EVENTS_MAX. */
int32_t offboard_link_take_events(OffboardLink *self, LinkEvent *events);

/* Share of the peer's datagrams that the link loses at present. */
real offboard_link_loss_share(OffboardLink *self, int64_t now_ns);

/* A batch as an authenticated datagram. False if a value is not allowed. */
bool offboard_link_batch(OffboardLink *self, const SampleBatch *batch, int64_t now_ns, Datagram *out);

/* Our own request and the answer to a challenge, each when due; returns their number, at most SYNC_DATAGRAMS_MAX. */
int32_t offboard_link_time_sync(OffboardLink *self, int64_t now_ns, Datagram *out);

/* Clock offset and round trip, ns, when due for the log. */
bool offboard_link_clock_record(OffboardLink *self, int64_t now_ns, ClockExchange *out);

/* Whether it is time for a status. */
bool offboard_link_status_due(const OffboardLink *self, int64_t now_ns);

/* The vehicle's status as a datagram; the next is due a period later. The caller fills in mode, versions, bitmap, refusal
 * and ticks; the link the others. False if a value is not allowed. */
bool offboard_link_status(OffboardLink *self, Status *status, int64_t last_pose_ns, int64_t now_ns, Datagram *out);

#endif
