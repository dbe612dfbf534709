/* Statistics of the link: counts, gaps and delays. The twin of protocol/statistics.py, which explains each. */
#ifndef DMRAC_STATISTICS_H
#define DMRAC_STATISTICS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "generated/constants.h"

typedef struct {
    int64_t sent;
    int64_t sent_bytes;
    int64_t received; /* those below concern datagrams from the peer */
    int64_t received_bytes;
    int64_t lost;
    int64_t duplicate;
    int64_t reordered;
    int64_t sessions;
    int64_t rejected[REJECTION_COUNT]; /* by Rejection */
    int64_t last_received_ns;          /* NEVER_NS before the first one */
    int64_t longest_gap_ns;
    int64_t delay_ns;
    double delay_mean_ns;
    int64_t delay_max_ns;
} LinkStatistics;

void link_statistics_init(LinkStatistics *self);
/* Count one accepted datagram. */
void link_statistics_count_received(LinkStatistics *self, size_t size, int64_t delay_ns, int64_t now_ns);
/* Rejected datagrams, whatever the reason; duplicates are not among them. */
int64_t link_statistics_rejected(const LinkStatistics *self);
/* Whether the peer has been heard, but not for at least `time_ns`. */
bool link_statistics_is_silent(const LinkStatistics *self, int64_t time_ns, int64_t now_ns);

#endif
