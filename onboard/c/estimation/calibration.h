/* Calibrates the IMU on the bench: means over some seconds at rest, motors off, before the first arming. The twin of
 * onboard/estimation/calibration.py, which explains it. */
#ifndef DMRAC_CALIBRATION_H
#define DMRAC_CALIBRATION_H

#include "estimation/events.h"
#include "estimation/readings.h"
#include "generated/config.h"

/* Why the vehicle must not be armed yet. */
typedef enum { CALIBRATION_NONE, CALIBRATION_RUNNING, CALIBRATION_MOVED, CALIBRATION_BIASED } CalibrationRefusal;

/* An accepted calibration. */
typedef struct {
    real force[3]; /* m/s^2, body: mean specific force */
    real rate[3];  /* rad/s, body: mean rate, which is the gyroscope's bias */
    int32_t samples;
    real seconds;
} Calibration;

/* Bias of the accelerometer along gravity, m/s^2, positive where it measures too much. */
real calibration_along_gravity(const Calibration *calibration);

/* Collects blocks of a resting vehicle. */
typedef struct {
    real limits[6];
    real bias_max; /* rad/s */
    int32_t blocks_wanted;
    CalibrationRefusal refusal;
    int32_t biased_axis; /* with CALIBRATION_BIASED */
    real bias;           /* rad/s, the same */
    bool has_accepted;
    Calibration accepted; /* the newest one, also while the vehicle is calibrated again */
    int32_t count;        /* calibrations accepted so far */
    int32_t movements;    /* how often a movement made a calibration begin again */
    bool running;
    int64_t began_ns;
    real sums[6];
    int32_t samples;
    real block_sums[6]; /* of the blocks that agree */
    int32_t blocks;
    int32_t collected;
    real collected_s;
} BenchCalibration;

void calibration_init(BenchCalibration *self, const EstimatorConfig *config);

/* Forget what has been collected: the vehicle is not at rest. A kept calibration stays. */
void calibration_interrupt(BenchCalibration *self);

/* Add a sample of a vehicle that rests with its motors off. */
void calibration_add(BenchCalibration *self, const ImuReading *reading, EstimatorEvents *events);

#endif
