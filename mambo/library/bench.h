/* The mode bench: after a pause each motor turns once, one at a time, slowly. Propellers off. */
#ifndef DMRAC_MAMBO_BENCH_H
#define DMRAC_MAMBO_BENCH_H

#include "motors.h"

typedef struct {
    BoardRecord config;
    bool started;
    int64_t started_ns;
} Bench;

void bench_init(Bench *self, const BoardRecord *config);

/* The motor of the firmware, 0 to 3, that turns now; -1: none. */
int32_t bench_step(Bench *self, Motors *motors, HalCommand *command, int64_t now_ns);

#endif
