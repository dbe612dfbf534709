#include "estimation/imu_conditioning.h"

#include <string.h>

#include "generated/constants.h"
#include "numerics/elementary.h"
#include "protocol/geometry.h"

/* StillStart.__init__ */
void still_start_init(StillStart *self, int32_t samples, real rate_max_rad_s) {
    memset(self, 0, sizeof *self);
    self->samples = samples;
    self->rate_max = rate_max_rad_s;
}

/* StillStart.add */
bool still_start_add(StillStart *self, const ImuReading *reading) {
    const real *rate = reading->gyroscope;
    real fastest = real_max(real_max(real_abs(rate[0]), real_abs(rate[1])), real_abs(rate[2]));
    real force_error = real_abs(vector_length(reading->accelerometer) - GRAVITY);
    if (!(fastest < self->rate_max && force_error < FORCE_ERROR_MAX)) {
        memset(self->sums, 0, sizeof self->sums);
        self->count = 0;
        return false;
    }
    vector_add(self->sums, reading->accelerometer, self->sums);
    vector_add(self->sums + 3, reading->gyroscope, self->sums + 3);
    self->count++;
    return self->count >= self->samples;
}

/* StillStart.level */
void still_start_level(const StillStart *self, real roll_pitch[2]) {
    real ax = self->sums[0], ay = self->sums[1], az = self->sums[2];
    roll_pitch[0] = real_atan2(-ay, -az);
    roll_pitch[1] = real_atan2(ax, real_sqrt(ay * ay + az * az));
}

/* StillStart.mean_rate */
void still_start_mean_rate(const StillStart *self, real rate[3]) {
    for (int i = 0; i < 3; i++) {
        rate[i] = self->sums[3 + i] / (real)self->count;
    }
}

/* VibrationMeter.__init__ */
void vibration_init(VibrationMeter *self) {
    memset(self, 0, sizeof *self);
}

/* VibrationMeter.update */
real vibration_update(VibrationMeter *self, const real accelerometer[3], real dt) {
    real high[3];
    if (!self->running) {
        self->running = true;
        vector_copy(accelerometer, self->low);
    }
    for (int i = 0; i < 3; i++) {
        high[i] = accelerometer[i] - self->low[i];
        self->low[i] = self->low[i] + VIBRATION_CORNER * high[i];
    }
    real magnitude = (REAL(1.0) - VIBRATION_CORNER) * vector_length(high);
    self->level += (magnitude - self->level) * dt / (VIBRATION_SMOOTHING_S + dt);
    return self->level;
}
