/* Measures the still start and the vibration level from IMU samples, before the filter uses them. The twin of
 * onboard/estimation/imu_conditioning.py. */
#ifndef DMRAC_IMU_CONDITIONING_H
#define DMRAC_IMU_CONDITIONING_H

#include "estimation/readings.h"

/* Means over still samples in a row. */
typedef struct {
    int32_t samples;
    real rate_max; /* rad/s */
    real sums[6];
    int32_t count;
} StillStart;

void still_start_init(StillStart *self, int32_t samples, real rate_max_rad_s);

/* Add a sample; true once there are enough. A sample that is not still starts the count again. */
bool still_start_add(StillStart *self, const ImuReading *reading);

/* Roll and pitch, rad, at which gravity gives the mean specific force. */
void still_start_level(const StillStart *self, real roll_pitch[2]);

/* Mean of the gyroscope, rad/s: its bias, since the vehicle is at rest. */
void still_start_mean_rate(const StillStart *self, real rate[3]);

/* Magnitude of the high-passed accelerometer, smoothed, m/s^2. */
typedef struct {
    bool running;
    real low[3];
    real level;
} VibrationMeter;

void vibration_init(VibrationMeter *self);

/* Add a sample; returns the vibration level. */
real vibration_update(VibrationMeter *self, const real accelerometer[3], real dt);

#endif
