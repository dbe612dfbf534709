/* A fuzz target for the link to offboard: the input is a script of what the peer, the radio and the core do.
 *
 * Any bytes are a script. A peer with the right key is part of the target, so that the script reaches what is behind the
 * MAC. After every datagram the target checks what must hold whatever came; a fault calls abort().
 */
#include "link_target.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "protocol/little_endian.h"

#define CHECK(condition) ((condition) ? (void)0 : fail(#condition, __LINE__))
#define KEY_SIZE 32
#define FIRST_SESSION (UINT64_C(1) << 40)
#define DATAGRAM_SPACE 1300 /* longer than allowed */

TargetCounts target_counts;

static void fail(const char *what, int line) {
    fprintf(stderr, "link_target.c:%d: does not hold: %s\n", line, what);
    abort();
}

/* --- the script --- */

typedef struct {
    const uint8_t *at;
    size_t left;
} Script;

/* The next number of `bytes` bytes; zero behind the end */
static uint64_t take(Script *from, int bytes) {
    uint64_t value = 0;
    for (; bytes > 0; bytes--) {
        value = value << 8 | (from->left > 0 ? *from->at : 0);
        from->at += from->left > 0;
        from->left -= from->left > 0;
    }
    return value;
}

static size_t take_bytes(Script *from, uint8_t *out, size_t most) {
    size_t size = from->left < most ? from->left : most;
    memcpy(out, from->at, size);
    from->at += size;
    from->left -= size;
    return size;
}

/* --- the peer --- */

typedef struct {
    OffboardLink link;
    Authenticator peer; /* of datagrams down */
    Authenticator up;
    int32_t vehicle_id;
    uint8_t layout[LAYOUT_BYTES]; /* of the peer */
    uint64_t session;
    uint64_t sequence;
    int64_t now_ns;
    int64_t origin_ns; /* of the link's newest request */
    uint8_t last[DATAGRAM_SPACE];
    size_t last_size;
} Scene;

/* Header and MAC around the body that lies behind the place of the header; returns the size */
static size_t seal(const Scene *scene, uint8_t *datagram, uint8_t type, uint64_t session, uint64_t sequence,
                   uint64_t sent_ns, size_t body_size) {
    size_t size = HEADER_BYTES + body_size;
    datagram[0] = PROTOCOL_VERSION;
    datagram[1] = type;
    datagram[2] = (uint8_t)scene->vehicle_id;
    datagram[3] = (uint8_t)(scene->vehicle_id >> 8);
    write_u64(datagram + 4, session);
    write_u64(datagram + 12, sequence);
    write_u64(datagram + 20, sent_ns);
    authenticator_mac(&scene->peer, datagram, size, datagram + size);
    return size + MAC_BYTES;
}

static void write_pose(Script *script, MsgpackWriter *body, int64_t peer_ns) {
    float position[3], quaternion[4] = {1.0F, 0.0F, 0.0F, 0.0F};
    for (int i = 0; i < 3; i++) {
        position[i] = (float)((int64_t)take(script, 2) - 32768) * 0.01F;
    }
    if (take(script, 1) % 16 == 0) { /* any bits: not finite, too large, not of unit length */
        uint8_t bits[8];
        write_u64(bits, take(script, 4));
        quaternion[take(script, 1) % 4] = read_f32(bits);
    }
    msgpack_write_array(body, 3);
    msgpack_write_number(body, peer_ns);
    msgpack_write_floats(body, position, 3);
    msgpack_write_floats(body, quaternion, 4);
}

static void write_chunk(Script *script, MsgpackWriter *body) {
    static const uint8_t zeros[CHUNK_DATA_MAX_BYTES + 1] = {0};
    msgpack_write_array(body, 5);
    msgpack_write_number(body, (int64_t)take(script, 1));
    msgpack_write_number(body, (int64_t)(take(script, 1) % 66));
    msgpack_write_number(body, (int64_t)(take(script, 1) % 66));
    msgpack_write_bytes(body, zeros, DIGEST_BYTES);
    msgpack_write_bytes(body, zeros, (int32_t)(take(script, 2) % (CHUNK_DATA_MAX_BYTES + 2)));
}

static void write_time_sync(Script *script, const Scene *scene, MsgpackWriter *body, int64_t peer_ns, bool reply) {
    int64_t receive_ns = take(script, 1) % 8 == 0 ? (int64_t)(take(script, 8) >> 1) : peer_ns;
    msgpack_write_array(body, reply ? 4 : 2);
    msgpack_write_number(body, reply ? scene->origin_ns : peer_ns);
    if (reply) {
        msgpack_write_number(body, receive_ns);
        msgpack_write_number(body, take(script, 1) % 16 == 0 ? INT64_MAX : receive_ns);
    }
    msgpack_write_bytes(body, scene->layout, LAYOUT_BYTES);
}

/* A message as the peer sends it, of the next sequence number; returns the size of the datagram */
static size_t peer_message(Script *script, Scene *scene, uint8_t *datagram) {
    static const uint8_t types[4] = {MESSAGE_TIME_SYNC_REQUEST, MESSAGE_FEATURE_CHUNK, MESSAGE_POSE,
                                     MESSAGE_TIME_SYNC_REPLY};
    MsgpackWriter body = {datagram + HEADER_BYTES, BODY_MAX_BYTES, 0, false};
    uint8_t type = types[take(script, 1) % 4];
    int64_t peer_ns = scene->now_ns / 2 + (int64_t)take(script, 3);
    if (type == MESSAGE_POSE) {
        write_pose(script, &body, peer_ns);
    } else if (type == MESSAGE_FEATURE_CHUNK) {
        write_chunk(script, &body);
    } else {
        write_time_sync(script, scene, &body, peer_ns, type == MESSAGE_TIME_SYNC_REPLY);
    }
    return seal(scene, datagram, type, scene->session, scene->sequence++, (uint64_t)peer_ns, (size_t)body.size);
}

/* Mostly with a higher number; datagrams are lost, too */
static void restart_peer(Script *script, Scene *scene) {
    uint64_t how = take(script, 1);
    scene->sequence += take(script, 1);
    if (how % 4 == 0) {
        scene->session = how % 8 == 0 ? scene->session + 1 : FIRST_SESSION + how;
    }
}

/* A sequence number: any, near the one that is due, or at the far end of the replay window */
static uint64_t some_sequence(Script *script, const Scene *scene, uint64_t how) {
    if (how & 32) {
        return scene->link.endpoint.peer.window.newest - REPLAY_WINDOW + 3 - take(script, 1) % 6;
    }
    return how & 2 ? scene->sequence + take(script, 2) % 600 - 300 : take(script, 8);
}

/* Any body of any type with the right MAC */
static size_t genuine_bytes(Script *script, Scene *scene, uint8_t *datagram) {
    uint64_t how = take(script, 1), sent_ns = take(script, how & 4 ? 8 : 2);
    uint64_t session = how & 1 ? scene->session : FIRST_SESSION + take(script, 1) % 8;
    uint64_t sequence = some_sequence(script, scene, how);
    uint8_t type = (uint8_t)take(script, 1);
    type = how & 8 ? (uint8_t)(type & 8 ? 64 + type % 4 : 3) : type;
    size_t room = how & 16 ? DATAGRAM_SPACE - HEADER_BYTES - MAC_BYTES : 40;
    size_t size = take_bytes(script, datagram + HEADER_BYTES, take(script, 2) % room);
    return seal(scene, datagram, type, session, sequence, sent_ns, size);
}

/* The last datagram with a few bytes changed, cut or as it was; with `sealed`, the MAC is right again */
static size_t spoilt(Script *script, const Scene *scene, uint8_t *datagram, bool sealed) {
    size_t size = scene->last_size;
    memcpy(datagram, scene->last, size);
    for (uint64_t changes = take(script, 1) % 4; changes > 0 && size > 0; changes--) {
        datagram[take(script, 2) % size] ^= (uint8_t)take(script, 1);
    }
    if (take(script, 1) % 8 == 0 && size > 0) {
        size = take(script, 2) % size;
    }
    if (sealed && size >= MAC_BYTES) {
        size_t signed_size = size - MAC_BYTES;
        authenticator_mac(&scene->peer, datagram, signed_size, datagram + signed_size);
    }
    return size;
}

/* --- what must hold --- */

static void check_received(const Scene *scene, const Received *received) {
    const ClockEstimate *clock = &scene->link.endpoint.clock;
    CHECK(!received->has_pose || !received->has_chunk);
    CHECK(!(received->has_pose || received->has_chunk) || clock->count > 0);
    if (received->has_pose) {
        const DatedPose *pose = &received->pose;
        double squares = 0.0;
        for (int i = 0; i < 4; i++) {
            squares += (double)pose->pose.quaternion[i] * (double)pose->pose.quaternion[i];
        }
        CHECK(fabs(squares - 1.0) < 2.1e-3);
        for (int i = 0; i < 3; i++) {
            CHECK(fabs((double)pose->pose.position[i]) <= 1e6);
        }
        CHECK(pose->time_sigma_s >= 0 && pose->arrival_ns == scene->now_ns);
    }
    if (received->has_chunk) {
        const FeatureChunk *chunk = &received->chunk;
        CHECK(1 <= chunk->count && chunk->count <= CHUNK_COUNT_MAX && 0 <= chunk->index && chunk->index < chunk->count);
        CHECK(1 <= chunk->size && chunk->size <= CHUNK_DATA_MAX_BYTES && 1 <= chunk->version);
    }
}

static void check_state(const Scene *scene) {
    const Endpoint *endpoint = &scene->link.endpoint;
    const LinkStatistics *statistics = &endpoint->statistics;
    CHECK(statistics->lost >= 0 && statistics->received >= 0 && statistics->delay_ns >= 0);
    CHECK(0 <= endpoint->clock.count && endpoint->clock.count <= CLOCK_SAMPLES_MAX);
    CHECK(0 <= endpoint->clock.open_count && endpoint->clock.open_count <= OPEN_REQUESTS_MAX);
    CHECK(endpoint->clock.count == 0 || endpoint->clock.best.round_trip_ns >= 0);
    CHECK(0 <= endpoint->peer.retired_count && endpoint->peer.retired_count <= RETIRED_MAX);
    CHECK(0 <= scene->link.event_count && scene->link.event_count <= LINK_EVENTS_MAX);
    CHECK(0 <= endpoint->allowance_ns && endpoint->allowance_ns <= 128000000);
}

/* Gives a datagram to the link, in memory of its exact size, so that the sanitizer sees what is read behind it */
static void deliver(Scene *scene, const uint8_t *datagram, size_t size) {
    const LinkStatistics *statistics = &scene->link.endpoint.statistics;
    LinkStatistics before = *statistics;
    bool genuine = size >= MAC_BYTES && authenticator_is_genuine(&scene->peer, datagram, size);
    uint8_t *exact = malloc(size > 0 ? size : 1);
    Received received;
    CHECK(exact != NULL);
    memcpy(exact, datagram, size);
    offboard_link_receive(&scene->link, exact, size, scene->now_ns, &received);
    free(exact);
    bool heard = statistics->received > before.received;
    int64_t refused = link_statistics_rejected(statistics) - link_statistics_rejected(&before);
    int64_t duplicate = statistics->duplicate - before.duplicate;
    bool content = received.peer_restarted || received.has_pose || received.has_chunk;
    CHECK(refused + duplicate <= 1 && refused >= 0 && duplicate >= 0);
    CHECK(heard || refused + duplicate == 1);
    CHECK(genuine || (!heard && duplicate == 0));
    CHECK(heard || !content);
    check_received(scene, &received);
    check_state(scene);
    target_counts.datagrams++;
    target_counts.accepted += heard && refused == 0;
    target_counts.poses += received.has_pose;
    target_counts.chunks += received.has_chunk;
    target_counts.restarts += received.peer_restarted;
    memmove(scene->last, datagram, size);
    scene->last_size = size;
}

/* What the link sends is from itself, and of the next sequence number */
static void check_sent(Scene *scene, const Datagram *sent, uint64_t sequence) {
    CHECK(sent->size >= DATAGRAM_MIN_BYTES && sent->size <= DATAGRAM_MAX_BYTES);
    CHECK(authenticator_is_genuine(&scene->up, sent->bytes, (size_t)sent->size));
    CHECK(read_u64(sent->bytes + 12) == sequence && sent->bytes[0] == PROTOCOL_VERSION);
    if (sent->bytes[1] == MESSAGE_TIME_SYNC_REQUEST) {
        scene->origin_ns = (int64_t)read_u64(sent->bytes + 20);
    }
    target_counts.sent++;
}

/* --- what the core does --- */

static void core_sends(Script *script, Scene *scene) {
    OffboardLink *link = &scene->link;
    Datagram sent[SYNC_DATAGRAMS_MAX];
    ClockExchange exchange;
    LinkEvent events[LINK_EVENTS_MAX];
    uint64_t sequence = link->endpoint.sequence;
    int32_t count = offboard_link_time_sync(link, scene->now_ns, sent);
    CHECK(0 <= count && count <= SYNC_DATAGRAMS_MAX);
    for (int32_t i = 0; i < count; i++) {
        check_sent(scene, sent + i, sequence++);
    }
    if (offboard_link_status_due(link, scene->now_ns)) {
        Status status = {.mode = 4, .received_chunks_size = (int32_t)(take(script, 1) % 12)};
        bool allowed = status.received_chunks_size <= BITMAP_BYTES;
        CHECK(offboard_link_status(link, &status, scene->now_ns - (int64_t)take(script, 5), scene->now_ns, sent) ==
              allowed);
        if (allowed) {
            check_sent(scene, sent, sequence++);
        }
    }
    SampleBatch batch = {.period_ns = 20000000, .count = (int32_t)(take(script, 1) % 16)};
    bool fits = 1 <= batch.count && batch.count <= SAMPLES_PER_BATCH_MAX;
    CHECK(offboard_link_batch(link, &batch, scene->now_ns, sent) == fits);
    if (fits) {
        check_sent(scene, sent, sequence++);
    }
    CHECK(link->endpoint.sequence == sequence);
    real share = offboard_link_loss_share(link, scene->now_ns);
    CHECK(share >= 0 && share <= 1);
    offboard_link_clock_record(link, scene->now_ns, &exchange);
    CHECK(offboard_link_take_events(link, events) <= LINK_EVENTS_MAX);
}

static void start(Script *script, Scene *scene) {
    static const uint8_t key[KEY_SIZE] = "not a secret: a key of the tests";
    static CoreConfig config;
    uint64_t how = take(script, 1);
    int32_t key_size = how & 1 ? KEY_SIZE : 0;
    memset(scene, 0, sizeof *scene);
    scene->vehicle_id = config.vehicle_id = how & 2 ? 1 : 0xabcd;
    config.status_period_s = REAL(0.1);
    config.time_sync_period_s = REAL(1.0);
    for (int i = 0; i < LAYOUT_BYTES; i++) {
        config.layout[i] = how & 4 ? 0 : 10 + i;
        scene->layout[i] = (uint8_t)(how & 8 ? 0 : 10 + i);
    }
    CHECK(offboard_link_init(&scene->link, &config, 1, key, key_size));
    CHECK(authenticator_init(&scene->peer, key, key_size, DIRECTION_DOWN));
    CHECK(authenticator_init(&scene->up, key, key_size, DIRECTION_UP));
    scene->session = FIRST_SESSION;
    scene->sequence = 1000;                          /* so that a script can go back by more than the window */
    scene->now_ns = (int64_t)(take(script, 8) >> 2); /* up to 146 years */
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    Script script = {data, size};
    Scene *scene = malloc(sizeof *scene);
    uint8_t datagram[DATAGRAM_SPACE];
    CHECK(scene != NULL);
    start(&script, scene);
    while (script.left > 0) {
        switch (take(&script, 1) % 16) {
            case 0: /* time passes, sometimes long */
                scene->now_ns += (int64_t)take(&script, 1) * (take(&script, 1) % 8 == 0 ? 20000000 : 500000);
                break;
            case 1: /* bytes of anyone */
                deliver(scene, datagram, take_bytes(&script, datagram, take(&script, 2) % DATAGRAM_SPACE));
                break;
            case 2:
            case 3:
                deliver(scene, datagram, genuine_bytes(&script, scene, datagram));
                break;
            case 4:
            case 5:
                deliver(scene, datagram, spoilt(&script, scene, datagram, false));
                break;
            case 6:
            case 7:
                deliver(scene, datagram, spoilt(&script, scene, datagram, true));
                break;
            case 8:
                restart_peer(&script, scene);
                break;
            case 9:
            case 10:
                core_sends(&script, scene);
                break;
            case 11: /* mostly one more message, sometimes a flood */
                for (uint64_t first = take(&script, 1), count = first > 240 ? 300 : 1; count > 0; count--) {
                    deliver(scene, datagram, peer_message(&script, scene, datagram));
                }
                break;
            default:
                deliver(scene, datagram, peer_message(&script, scene, datagram));
        }
    }
    for (int i = 0; i < REJECTION_COUNT; i++) {
        target_counts.rejected[i] += (uint64_t)scene->link.endpoint.statistics.rejected[i];
    }
    target_counts.duplicate += (uint64_t)scene->link.endpoint.statistics.duplicate;
    free(scene);
    return 0;
}
