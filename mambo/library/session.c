#include "session.h"

#include <stdio.h>

/* protocol.session.session_number: milliseconds in 44 bits, then 20 bits that the library leaves 0. */
static uint64_t of_clock(int64_t wall_clock_ns) {
    return ((uint64_t)(wall_clock_ns / 1000000) & ((UINT64_C(1) << 44) - 1)) << 20;
}

/* The number that a text begins with; 0 for another text. */
static uint64_t number_of(const char *text) {
    uint64_t number = 0;
    for (; *text >= '0' && *text <= '9'; text++) {
        number = 10 * number + (uint64_t)(*text - '0');
    }
    return number;
}

uint64_t next_session(const char *path, int64_t wall_clock_ns) {
    char text[32] = "";
    uint64_t session = of_clock(wall_clock_ns);
    FILE *file = fopen(path, "r");
    if (file) {
        text[fread(text, 1, sizeof text - 1, file)] = '\0';
        fclose(file);
    }
    uint64_t stored = number_of(text);
    session = session <= stored ? stored + 1 : session;
    file = fopen(path, "w");
    if (file) {
        fprintf(file, "%llu\n", (unsigned long long)session);
        fclose(file);
    }
    return session;
}
