#include "motors.h"

#include <string.h>

#include "numerics/elementary.h"

void motors_init(Motors *self, const BoardMotors *config) {
    memset(self, 0, sizeof *self);
    self->config = *config;
}

static void set_word(Motors *self, HalCommand *out) {
    out->command = self->running ? MOTORS_RUN : MOTORS_START;
    self->running = true;
}

void motors_stop(Motors *self, HalCommand *out) {
    self->running = false;
    out->command = MOTORS_STOP;
    for (int i = 0; i < 4 && out->motors_speed; i++) {
        out->motors_speed[i] = 0;
    }
}

static int16_t command_of(const BoardMotors *config, real share) {
    real most = (real)config->command_max;
    real command = real_clip(most * share, (real)config->command_min, most);
    return (int16_t)(int32_t)(command + REAL(0.5));
}

void motors_write(Motors *self, const real shares[4], bool spinning, HalCommand *out) {
    bool finite = true;
    for (int i = 0; i < 4; i++) {
        finite = finite && real_is_finite(shares[i]);
    }
    if (!spinning || !finite || !out->motors_speed) {
        motors_stop(self, out);
        return;
    }
    for (int i = 0; i < 4; i++) {
        out->motors_speed[i] = command_of(&self->config, shares[self->config.order[i] - 1]);
    }
    set_word(self, out);
}

void motors_write_one(Motors *self, int32_t motor, int32_t command, HalCommand *out) {
    if (!out->motors_speed) {
        motors_stop(self, out);
        return;
    }
    for (int i = 0; i < 4; i++) {
        out->motors_speed[i] = (int16_t)(i == motor ? command : 0);
    }
    set_word(self, out);
}
