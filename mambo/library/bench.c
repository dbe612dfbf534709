#include "bench.h"

#include <string.h>

void bench_init(Bench *self, const BoardRecord *config) {
    memset(self, 0, sizeof *self);
    self->config = *config;
}

int32_t bench_step(Bench *self, Motors *motors, HalCommand *command, int64_t now_ns) {
    int64_t turn_ns = (int64_t)(1e9 * (double)self->config.bench_turn_s);
    int64_t cycle_ns = turn_ns + (int64_t)(1e9 * (double)self->config.bench_pause_s);
    if (!self->started) {
        self->started = true;
        self->started_ns = now_ns;
    }
    int64_t passed_ns = now_ns - self->started_ns; /* each cycle is a pause, then a motor */
    int64_t motor = passed_ns / cycle_ns;
    if (motor > 3 || passed_ns % cycle_ns < cycle_ns - turn_ns) {
        motors_stop(motors, command);
        return -1;
    }
    motors_write_one(motors, (int32_t)motor, self->config.bench_command, command);
    return (int32_t)motor;
}
