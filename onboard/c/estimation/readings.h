/* Readings of the vehicle's sensors, checked and in the onboard clock, and the pose of a motion capture: the twins of the
 * records in protocol/mavlink/vehicle.py and protocol/messages.py. */
#ifndef DMRAC_READINGS_H
#define DMRAC_READINGS_H

#include <stdbool.h>
#include <stdint.h>

#include "numerics/real.h"

typedef struct {
    int64_t time_ns;       /* when the sample was taken */
    real accelerometer[3]; /* specific force, m/s^2, body FRD */
    real gyroscope[3];     /* rad/s, body FRD */
    bool has_pressure;
    real pressure_pa;
} ImuReading;

/* Flow of the downward camera over `integration_s`, which ends at `time_ns`. */
typedef struct {
    int64_t time_ns;
    real integration_s;
    real flow_x;     /* rad, about body x */
    real flow_y;     /* rad, about body y */
    real rotation_x; /* rad, integrated gyroscope about body x over the same time */
    real rotation_y; /* rad, about body y */
    int32_t quality; /* 0 (worst) to 255 */
} FlowReading;

/* Distance to the floor along body +z. */
typedef struct {
    int64_t time_ns;
    real distance_m;
} RangeReading;

typedef struct {
    int64_t time_ns; /* of arrival */
    real voltage_v;
    real remaining; /* fraction; negative when unknown */
} BatteryReading;

typedef struct {
    real position[3];   /* m, world NED */
    real quaternion[4]; /* wxyz, body FRD to world NED */
} Pose;

#endif
