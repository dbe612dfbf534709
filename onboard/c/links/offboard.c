#include "links/offboard.h"

#include <string.h>

#include "numerics/whole.h"

#define NS_PER_MS 1000000

/* OffboardLink.__init__ */
bool offboard_link_init(OffboardLink *self, const CoreConfig *config, uint64_t session, const uint8_t *key,
                        int32_t key_size) {
    uint8_t layout[LAYOUT_BYTES];
    memset(self, 0, sizeof *self);
    for (int i = 0; i < LAYOUT_BYTES; i++) {
        layout[i] = (uint8_t)config->layout[i];
    }
    self->status_period_ns = nanoseconds_nearest(config->status_period_s);
    self->sync_period_ns = nanoseconds_nearest(config->time_sync_period_s);
    loss_rate_init(&self->loss);
    self->asked_ns = self->answered_ns = self->last_received_ns = NEVER_NS;
    return endpoint_init(&self->endpoint, session, key, key_size, config->vehicle_id, layout);
}

static LinkEvent *new_event(OffboardLink *self, LinkEventKind kind, int64_t time_ns) {
    if (self->event_count == LINK_EVENTS_MAX) {
        self->events_lost++;
        self->event_count--;
    }
    LinkEvent *event = self->events + self->event_count++;
    memset(event, 0, sizeof *event);
    event->kind = kind;
    event->time_ns = time_ns;
    return event;
}

/* OffboardLink.take_events */
int32_t offboard_link_take_events(OffboardLink *self, LinkEvent *events) {
    int32_t count = self->event_count;
    memcpy(events, self->events, (size_t)count * sizeof *events);
    self->event_count = 0;
    return count;
}

/* --- receiving --- */

/* OffboardLink._report_layout: once per session of the peer */
static void report_layout(OffboardLink *self, int64_t now_ns) {
    const Endpoint *endpoint = &self->endpoint;
    bool reported = self->has_reported_session && self->reported_session == endpoint->peer.current;
    if (!endpoint_layout_differs(endpoint) || reported) {
        return;
    }
    self->has_reported_session = true;
    self->reported_session = endpoint->peer.current;
    LinkEvent *event = new_event(self, LINK_LAYOUT_DIFFERS, now_ns);
    memcpy(event->peer_layout, endpoint->peer_layout, LAYOUT_BYTES);
    memcpy(event->layout, endpoint->layout, LAYOUT_BYTES);
}

/* OffboardLink._begin_session: whether the peer has restarted */
static bool begin_session(OffboardLink *self, int64_t now_ns) {
    bool restarted = self->has_peer_session;
    self->has_peer_session = true;
    self->peer_session = self->endpoint.peer.current;
    if (!restarted) {
        self->next_sync_ns = now_ns;
        return false;
    }
    new_event(self, LINK_PEER_RESTARTED, now_ns);
    self->next_sync_ns = whole_min(self->next_sync_ns, self->asked_ns + self->status_period_ns);
    return true;
}

/* OffboardLink._time_sigma_s */
static real time_sigma_s(const ClockEstimate *clock) {
    int64_t slow_ns = whole_max(clock->best.round_trip_ns - GOOD_ROUND_TRIP_NS, 0);
    return ROUND_TRIP_TO_SIGMA * (real)slow_ns * REAL(1e-9);
}

/* OffboardLink.receive */
void offboard_link_receive(OffboardLink *self, const uint8_t *datagram, size_t size, int64_t now_ns, Received *out) {
    const ClockEstimate *clock = &self->endpoint.clock;
    Message message;
    memset(out, 0, sizeof *out);
    if (!endpoint_decode(&self->endpoint, datagram, size, now_ns, &message)) {
        return;
    }
    self->last_received_ns = now_ns;
    report_layout(self, now_ns);
    if (!self->has_peer_session || self->endpoint.peer.current != self->peer_session) {
        out->peer_restarted = begin_session(self, now_ns);
    }
    bool alive = clock_estimate_is_known(clock);
    if (message.type == MESSAGE_POSE && alive) { /* else it has no time, and may be a recording */
        int64_t taken_ns = whole_difference(message.pose.time_ns, clock->best.offset_ns);
        out->has_pose = true;
        out->pose = (DatedPose){message.pose.pose, taken_ns, now_ns, time_sigma_s(clock)};
    } else if (message.type == MESSAGE_FEATURE_CHUNK && alive) {
        out->has_chunk = true;
        out->chunk = message.chunk;
    } else if (message.type == MESSAGE_FEATURE_CHUNK) {
        self->endpoint.statistics.rejected[REJECTED_NOT_ALIVE]++;
    } else if (message.type == MESSAGE_TIME_SYNC_REQUEST) {
        self->challenged = true;
        self->challenge_origin_ns = message.request.origin_ns;
        self->challenge_receive_ns = now_ns;
    }
}

/* OffboardLink.loss_share */
real offboard_link_loss_share(OffboardLink *self, int64_t now_ns) {
    return loss_rate_step(&self->loss, &self->endpoint.statistics, now_ns);
}

/* --- sending --- */

/* OffboardLink.encode of a SampleBatch */
bool offboard_link_batch(OffboardLink *self, const SampleBatch *batch, int64_t now_ns, Datagram *out) {
    return endpoint_encode_sample_batch(&self->endpoint, batch, now_ns, out);
}

/* OffboardLink.time_sync */
int32_t offboard_link_time_sync(OffboardLink *self, int64_t now_ns, Datagram *out) {
    Endpoint *endpoint = &self->endpoint;
    int32_t count = 0;
    if (self->challenged && now_ns - self->answered_ns >= CHALLENGE_PERIOD_NS) {
        self->challenged = false;
        self->answered_ns = now_ns;
        count += endpoint_encode_reply(endpoint, self->challenge_origin_ns, self->challenge_receive_ns, now_ns, now_ns,
                                       out + count);
    }
    if (now_ns >= self->next_sync_ns) {
        bool known = clock_estimate_is_known(&endpoint->clock); /* no pose can be used before: ask with each status */
        self->asked_ns = now_ns;
        self->next_sync_ns = now_ns + (known ? self->sync_period_ns : self->status_period_ns);
        count += endpoint_encode_request(endpoint, now_ns, now_ns, out + count);
    }
    return count;
}

/* OffboardLink.clock_record */
bool offboard_link_clock_record(OffboardLink *self, int64_t now_ns, ClockExchange *out) {
    if (!clock_estimate_is_known(&self->endpoint.clock) || now_ns < self->next_clock_record_ns) {
        return false;
    }
    self->next_clock_record_ns = now_ns + CLOCK_RECORD_PERIOD_NS;
    *out = self->endpoint.clock.best;
    return true;
}

/* OffboardLink.status_due */
bool offboard_link_status_due(const OffboardLink *self, int64_t now_ns) {
    return now_ns >= self->next_status_ns;
}

/* OffboardLink.status */
bool offboard_link_status(OffboardLink *self, Status *status, int64_t last_pose_ns, int64_t now_ns, Datagram *out) {
    const LinkStatistics *statistics = &self->endpoint.statistics;
    int64_t age_ms = whole_max(whole_difference(now_ns, last_pose_ns), 0) / NS_PER_MS;
    self->next_status_ns = now_ns + self->status_period_ns;
    status->pose_age_ms = last_pose_ns == NEVER_NS ? -1 : whole_min(age_ms, AGE_MAX_MS);
    status->received = statistics->received;
    status->lost = statistics->lost;
    status->rejected = link_statistics_rejected(statistics);
    return endpoint_encode_status(&self->endpoint, status, now_ns, out);
}
