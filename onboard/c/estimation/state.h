/* The estimated state of the vehicle: the twin of onboard/estimation/state.py. */
#ifndef DMRAC_STATE_H
#define DMRAC_STATE_H

#include <stdbool.h>
#include <stdint.h>

#include "estimation/error_state_filter.h"
#include "estimation/readings.h"
#include "numerics/real.h"

/* The vehicle's state now. World is NED, body is FRD. */
typedef struct {
    int64_t time_ns;              /* of the newest IMU sample, onboard clock */
    real position[3];             /* m, world */
    real velocity[3];             /* m/s, world */
    real quaternion[4];           /* wxyz, body to world */
    real rotation[9];             /* body to world, row by row */
    real euler[3];                /* roll, pitch, yaw, rad */
    real rates[3];                /* rad/s, body, bias removed */
    real specific_force[3];       /* m/s^2, body, bias removed */
    real gyro_bias[3];            /* rad/s */
    real accelerometer_bias[3];   /* m/s^2 */
    real position_sigma_m;        /* largest horizontal standard deviation of the position estimate */
    real velocity_sigma_m_s;      /* largest standard deviation of the velocity estimate */
    real vibration;               /* m/s^2, magnitude of the high-passed accelerometer, smoothed */
    real tilt_rad;                /* angle between body z and world z */
    bool height_valid;            /* height was recently corrected by pose or ultrasonic range */
    bool initialised;             /* attitude is known; before that the state must not be used */
    int32_t position_reset_count; /* jumps of the position estimate */
    real position_jump[3];        /* m, world: new minus old position at the latest jump */
    real yaw_jump;                /* rad: new minus old yaw at the latest jump */
    int64_t last_imu_ns;
    int64_t last_pose_ns;         /* arrival of the newest pose that was accepted, onboard clock */
    int64_t last_velocity_aid_ns; /* newest accepted pose or flow, onboard clock */
    int64_t last_height_ns;       /* newest accepted pose or range, onboard clock */
} VehicleState;

void state_init(VehicleState *self);

/* Copy everything that changes with an IMU sample. */
void state_publish(VehicleState *self, const ErrorStateFilter *source, const ImuReading *reading);

/* Copy quaternion, rotation matrix, Euler angles and tilt. */
void state_publish_attitude(VehicleState *self, const ErrorStateFilter *source);

/* Copy the standard deviations of position and velocity. */
void state_publish_sigmas(VehicleState *self, const ErrorStateFilter *source);

#endif
