/* A clock that never goes back, and the offset of the peer's clock from time sync exchanges: the twin of
 * protocol/clock.py, which explains both. */
#ifndef DMRAC_CLOCK_H
#define DMRAC_CLOCK_H

#include <stdbool.h>
#include <stdint.h>

#include "generated/constants.h"

typedef struct {
    bool started;
    int64_t latest_ns;
    int64_t shift_ns;
    int64_t jumps; /* how often the source went back */
} ForwardClock;

typedef struct {
    int64_t round_trip_ns;
    int64_t offset_ns;
} ClockExchange;

/* The offset, peer clock minus own clock, ns. */
typedef struct {
    int64_t open[OPEN_REQUESTS_MAX]; /* requests that are not answered, oldest first */
    int32_t open_count;
    ClockExchange exchanges[CLOCK_SAMPLES_MAX]; /* a ring */
    int32_t next;
    int32_t count;
    ClockExchange best; /* valid if there is one, that is if count > 0 */
    int64_t jumps;
} ClockEstimate;

void forward_clock_init(ForwardClock *self);
/* The time, ns, when the source shows `now_ns`. */
int64_t forward_clock_at(ForwardClock *self, int64_t now_ns);

void clock_estimate_init(ClockEstimate *self);
/* Discard all exchanges, as after a restart of the peer; open requests stay open. */
void clock_estimate_restart(ClockEstimate *self);
/* Store a request that is sent now; the oldest is forgotten if there are too many. */
void clock_estimate_note_request(ClockEstimate *self, int64_t origin_ns);
/* Whether a reply with this origin answers an own request that is recent and not answered yet. */
bool clock_estimate_is_open(const ClockEstimate *self, int64_t origin_ns, int64_t now_ns);
/* Receive a reply; false if its request is not open or its round trip would be negative. */
bool clock_estimate_receive_reply(ClockEstimate *self, int64_t origin_ns, int64_t receive_ns, int64_t transmit_ns,
                                  int64_t now_ns);
/* Whether the offset is known, which also proves that the peer is alive and not a recording. */
bool clock_estimate_is_known(const ClockEstimate *self);

#endif
