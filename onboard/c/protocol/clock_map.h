/* Maps the clock of a sender to ours, from the delays of its datagrams: the twin of protocol/clock_map.py. */
#ifndef DMRAC_CLOCK_MAP_H
#define DMRAC_CLOCK_MAP_H

#include <stdbool.h>
#include <stdint.h>

#include "generated/constants.h"

#define CLOCK_BUCKETS (CLOCK_WINDOW_NS / CLOCK_BUCKET_NS)

/* The two least delays of some time, ns; INT64_MAX if there are fewer. */
typedef struct {
    int64_t least_ns;
    int64_t second_ns;
} LeastDelays;

typedef struct {
    int64_t index; /* of the bucket: time over CLOCK_BUCKET_NS */
    LeastDelays delays;
} DelayBucket;

typedef struct {
    bool known;        /* there is a mapping */
    int64_t offset_ns; /* our clock minus the sender's; valid if known */
    DelayBucket current;
    DelayBucket sealed[CLOCK_BUCKETS]; /* earlier buckets within the window, oldest first */
    int32_t sealed_count;
    LeastDelays window; /* of the sealed ones */
} ClockMap;

/* Also forgets all delays: the next one starts a new mapping. */
void clock_map_init(ClockMap *self);
/* Whether a delay is too small for the mapping: the stamp is wrong, or the clock has jumped forwards. */
bool clock_map_is_ahead(const ClockMap *self, int64_t delay_ns);
/* Add the delay of a datagram (arrival - stamp) that arrived at `arrival_ns`. */
void clock_map_add(ClockMap *self, int64_t delay_ns, int64_t arrival_ns);
/* Our time of a stamp that arrived at `arrival_ns`: never after its arrival. */
int64_t clock_map_to_ours(const ClockMap *self, int64_t stamp_ns, int64_t arrival_ns);

#endif
