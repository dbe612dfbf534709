/* What link_target.c has counted, for the report of fuzz_main.c. */
#ifndef DMRAC_LINK_TARGET_H
#define DMRAC_LINK_TARGET_H

#include <stddef.h>
#include <stdint.h>

#include "links/offboard.h"

typedef struct {
    uint64_t datagrams; /* given to the link */
    uint64_t accepted;
    uint64_t poses;
    uint64_t chunks;
    uint64_t restarts;
    uint64_t sent; /* by the link */
    uint64_t duplicate;
    uint64_t rejected[REJECTION_COUNT];
} TargetCounts;

extern TargetCounts target_counts;

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

#endif
