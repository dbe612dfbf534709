/* Motor commands of the firmware: order, scale, and the words START, RUN and STOP. */
#ifndef DMRAC_MAMBO_MOTORS_H
#define DMRAC_MAMBO_MOTORS_H

#include <stdbool.h>

#include "firmware.h"
#include "generated/settings.h"

typedef struct {
    BoardMotors config;
    bool running; /* START has been given */
} Motors;

void motors_init(Motors *self, const BoardMotors *config);

/* Shares [4] of the maximum thrust, PX4 order. Off unless `spinning` and all of them finite. */
void motors_write(Motors *self, const real shares[4], bool spinning, HalCommand *out);

/* One motor of the firmware, 0 to 3, at a command of its own; the others off. */
void motors_write_one(Motors *self, int32_t motor, int32_t command, HalCommand *out);

void motors_stop(Motors *self, HalCommand *out);

#endif
