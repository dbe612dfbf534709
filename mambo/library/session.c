#include "session.h"

#include <stdio.h>

/* protocol.session.session_number: milliseconds in 44 bits, then 20 bits that the library leaves 0. */
static uint64_t of_clock(int64_t wall_clock_ns) {
    return ((uint64_t)(wall_clock_ns / 1000000) & ((UINT64_C(1) << 44) - 1)) << 20;
}

uint64_t next_session(const char *path, int64_t wall_clock_ns) {
    unsigned long long stored = 0;
    uint64_t session = of_clock(wall_clock_ns);
    FILE *file = fopen(path, "r");
    if (file) {
        if (fscanf(file, "%llu", &stored) != 1) {
            stored = 0;
        }
        fclose(file);
    }
    if (session <= stored) {
        session = stored + 1;
    }
    file = fopen(path, "w");
    if (file) {
        fprintf(file, "%llu\n", (unsigned long long)session);
        fclose(file);
    }
    return session;
}
