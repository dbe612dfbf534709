/* Finds an axis of the gyroscope that is stuck in flight, and replaces its rate by one from the motors' torque. The twin
 * of onboard/estimation/stuck_gyro.py, which explains it. */
#ifndef DMRAC_STUCK_GYRO_H
#define DMRAC_STUCK_GYRO_H

#include <stdbool.h>
#include <stdint.h>

#include "generated/constants.h"

typedef struct {
    real rates[3];
    real dt;
    real u_hat[3];       /* rad/s^2, since the sample before */
    real disturbance[3]; /* rad/s^2, known before this sample */
} GyroSample;

typedef struct {
    real dt;
    int64_t time_ns;
    real bias[3];
} GyroBias;

/* The axes that a sample showed to be stuck. */
typedef struct {
    int32_t count;
    int32_t axis[3];
    real turn_rad[3]; /* about that axis, since it is stuck, beyond the turn by its samples */
} FoundAxes;

typedef struct {
    int32_t needed; /* equal samples in a row that mean stuck; 0: never */
    real filter_s;
    GyroSample samples[GYRO_KEPT]; /* a ring */
    int32_t samples_first;
    int32_t samples_count;
    real last_rates[3];
    real last_accelerometer[3];
    int32_t runs[3];
    int32_t limits[3];
    bool found[3];
    real u_hat[3];
    real disturbance[3];
    real rates[3];
    GyroBias biases[GYRO_KEPT]; /* a ring */
    int32_t biases_first;
    int32_t biases_count;
    bool stuck[3]; /* the axes that are */
} StuckGyro;

void stuck_gyro_init(StuckGyro *self, int32_t samples, real disturbance_filter_s);

/* Whether any axis is stuck. */
bool stuck_gyro_any(const StuckGyro *self);

/* Believe the gyroscope again: on the floor the checks before arming judge it. */
void stuck_gyro_reset(StuckGyro *self);

/* The motors' angular acceleration over the last `dt`, and what it left unexplained, rad/s^2, body FRD. */
void stuck_gyro_expect(StuckGyro *self, const real u_hat[3], const real residual[3], real dt);

/* Add a sample, rad/s and m/s^2; the axes that are found stuck by it, in flight only. */
void stuck_gyro_receive(StuckGyro *self, const real rates[3], const real accelerometer[3], real dt, bool flying,
                        FoundAxes *found);

/* The rates of a sample, rad/s, with those of stuck axes replaced. */
void stuck_gyro_replaced(const StuckGyro *self, const real rates[3], real out[3]);

/* The filter's bias, which a sample has been integrated with. */
void stuck_gyro_note_bias(StuckGyro *self, const real bias[3], int64_t time_ns, real dt);

/* The turn that the present bias, had it been known, would have added since `time_ns`; rad, body FRD. */
void stuck_gyro_turn_since(const StuckGyro *self, int64_t time_ns, const real bias[3], real turn[3]);

#endif
