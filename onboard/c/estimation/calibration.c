#include "estimation/calibration.h"

#include <string.h>

#include "generated/constants.h"
#include "numerics/elementary.h"
#include "protocol/geometry.h"

#define NOTHING_BEYOND (-1)

/* Calibration.along_gravity_m_s2 */
real calibration_along_gravity(const Calibration *calibration) {
    return vector_length(calibration->force) - GRAVITY;
}

/* BenchCalibration._begin_block */
static void begin_block(BenchCalibration *self) {
    memset(self->sums, 0, sizeof self->sums);
    self->samples = 0;
}

/* BenchCalibration._begin */
static void begin(BenchCalibration *self) {
    memset(self->block_sums, 0, sizeof self->block_sums);
    self->blocks = self->collected = 0;
    self->collected_s = REAL(0.0);
}

/* BenchCalibration.__init__ */
void calibration_init(BenchCalibration *self, const EstimatorConfig *config) {
    memset(self, 0, sizeof *self);
    for (int i = 0; i < 3; i++) {
        self->limits[i] = config->calibration_force_max_m_s2;
        self->limits[3 + i] = config->calibration_rate_max_rad_s;
    }
    self->bias_max = config->calibration_bias_max_rad_s;
    self->blocks_wanted = (int32_t)-real_floor(-config->calibration_s / CALIBRATION_BLOCK_S);
    self->refusal = self->blocks_wanted > 0 ? CALIBRATION_RUNNING : CALIBRATION_NONE;
}

/* BenchCalibration.interrupt */
void calibration_interrupt(BenchCalibration *self) {
    self->running = false;
    begin_block(self);
    begin(self);
}

/* _first_beyond: the first value that is off its mean by more than its limit */
static int32_t first_beyond(const real *values, const real *means, const real *limits, int32_t count) {
    for (int32_t i = 0; i < count; i++) {
        if (!(real_abs(values[i] - means[i]) <= limits[i])) {
            return i;
        }
    }
    return NOTHING_BEYOND;
}

/* BenchCalibration._mean */
static void mean_of_blocks(const BenchCalibration *self, real mean[6]) {
    for (int i = 0; i < 6; i++) {
        mean[i] = self->block_sums[i] / (real)self->blocks;
    }
}

/* BenchCalibration._restart: begin again with the next block. Only the first of several movements in a row is an event. */
static void restart(BenchCalibration *self, int32_t index, real change, int64_t now_ns, EstimatorEvents *events) {
    begin(self);
    if (self->refusal == CALIBRATION_MOVED) {
        return;
    }
    self->refusal = CALIBRATION_MOVED;
    self->movements++;
    estimator_report(events, now_ns, ESTIMATOR_MOVED, index)->values[0] = change;
}

/* Whole hundredths of a bias: what its text shows. */
static int64_t hundredths(real bias) {
    return (int64_t)real_floor(bias * REAL(100.0) + REAL(0.5));
}

/* The gyroscope's bias is too large; an event unless the same was said before. */
static void refuse_bias(BenchCalibration *self, int32_t axis, real bias, int64_t now_ns, EstimatorEvents *events) {
    bool said =
        self->refusal == CALIBRATION_BIASED && self->biased_axis == axis && hundredths(self->bias) == hundredths(bias);
    self->refusal = CALIBRATION_BIASED;
    self->biased_axis = axis;
    self->bias = bias;
    if (!said) {
        EstimatorEvent *event = estimator_report(events, now_ns, ESTIMATOR_BIASED, axis);
        event->values[0] = bias;
        event->values[1] = self->bias_max;
    }
}

/* BenchCalibration._conclude: accept the calibration, unless the gyroscope's bias is too large */
static void conclude(BenchCalibration *self, int64_t now_ns, EstimatorEvents *events) {
    real mean[6];
    const real zero[3] = {REAL(0.0), REAL(0.0), REAL(0.0)};
    const real most[3] = {self->bias_max, self->bias_max, self->bias_max};
    mean_of_blocks(self, mean);
    Calibration found = {.samples = self->collected, .seconds = self->collected_s};
    begin(self);
    int32_t off = first_beyond(mean + 3, zero, most, 3);
    if (off != NOTHING_BEYOND) {
        refuse_bias(self, off, mean[3 + off], now_ns, events);
        return;
    }
    vector_copy(mean, found.force);
    vector_copy(mean + 3, found.rate);
    self->accepted = found;
    self->has_accepted = true;
    self->refusal = CALIBRATION_NONE;
    self->count++;
    EstimatorEvent *event = estimator_report(events, now_ns, ESTIMATOR_CALIBRATED, 0);
    vector_copy(found.rate, event->values);
    event->values[3] = calibration_along_gravity(&found);
    event->values[4] = found.seconds;
}

/* BenchCalibration._judge: compare a block with the calibration that is kept, or with the blocks before */
static void judge(BenchCalibration *self, const real block[6], int32_t samples, real seconds, int64_t now_ns,
                  EstimatorEvents *events) {
    if (self->refusal == CALIBRATION_NONE && self->has_accepted) {
        const real *kept = self->accepted.rate;
        int32_t off = first_beyond(block + 3, kept, self->limits + 3, 3);
        if (off != NOTHING_BEYOND) {
            restart(self, 3 + off, block[3 + off] - kept[off], now_ns, events);
        }
        return;
    }
    if (self->blocks > 0) {
        real mean[6];
        mean_of_blocks(self, mean);
        int32_t off = first_beyond(block, mean, self->limits, 6);
        if (off != NOTHING_BEYOND) {
            restart(self, off, block[off] - mean[off], now_ns, events);
            return;
        }
    }
    for (int i = 0; i < 6; i++) {
        self->block_sums[i] += block[i];
    }
    self->blocks++;
    self->collected += samples;
    self->collected_s += seconds;
    if (self->blocks == self->blocks_wanted) {
        conclude(self, now_ns, events);
    }
}

/* BenchCalibration.add */
void calibration_add(BenchCalibration *self, const ImuReading *reading, EstimatorEvents *events) {
    if (self->blocks_wanted == 0) {
        return;
    }
    if (!self->running) {
        self->running = true;
        self->began_ns = reading->time_ns;
    }
    vector_add(self->sums, reading->accelerometer, self->sums);
    vector_add(self->sums + 3, reading->gyroscope, self->sums + 3);
    self->samples++;
    int64_t lasted_ns = reading->time_ns - self->began_ns;
    if ((double)lasted_ns < (double)CALIBRATION_BLOCK_S * 1e9) {
        return;
    }
    real block[6], seconds = (real)lasted_ns * REAL(1e-9);
    int32_t samples = self->samples;
    for (int i = 0; i < 6; i++) {
        block[i] = self->sums[i] / (real)samples;
    }
    begin_block(self);
    self->began_ns = reading->time_ns;
    if (samples < CALIBRATION_LEAST_SAMPLES) {
        begin(self);
        return;
    }
    judge(self, block, samples, seconds, reading->time_ns, events);
}
