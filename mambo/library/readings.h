/* From the firmware's acquisition structure and flow calls to the core's readings: axes, signs, units, times, and what
 * is new.
 *
 * IMU: five samples of 1 kHz come with each call; their mean is one reading. Its time is that of an even clock that
 * follows the calls: the scheduler's jitter is not in the samples. An acquisition that repeats to the bit is no
 * reading; after `frozen_calls` of them the sensors count as frozen. Flow: the firmware gives m/s. The core wants
 * angles, with the camera's own rotation: angle = rotation + v dt / d, with d the distance along body z and the
 * rotation of the gyroscope since the last flow. Ultrasonic and pressure are readings when they change, the battery
 * once a second. */
#ifndef DMRAC_MAMBO_READINGS_H
#define DMRAC_MAMBO_READINGS_H

#include "estimation/readings.h"
#include "firmware.h"
#include "generated/settings.h"

/* Calls of RSEDU_optical_flow between two calls of RSEDU_control that are kept. */
#define FLOW_CALLS_MAX 8

/* One call of RSEDU_optical_flow. */
typedef struct {
    int64_t time_ns;
    float velocity[3]; /* m/s, the firmware's axes */
    int32_t defined;
    float quality;
} FlowCall;

/* Why values were dropped; counted. */
typedef enum { DROPPED_IMU, DROPPED_FLOW, DROPPED_RANGE, DROPPED_PRESSURE, DROPPED_BATTERY, DROPPED_COUNT } Dropped;

/* What came with one call. */
typedef struct {
    bool has_imu;
    ImuReading imu;
    FlowReading flows[FLOW_CALLS_MAX];
    int32_t flow_count;
    bool has_range;
    RangeReading range;
    bool has_battery;
    BatteryReading battery;
} Readings;

/* The vehicle as the flow needs it. */
typedef struct {
    bool known;
    real distance_m;   /* to the floor, along body z */
    real gyro_bias[3]; /* rad/s */
} FlowGeometry;

typedef struct {
    BoardLayout layout;
    BoardSensors sensors;
    ArmingLimits limits;
    int64_t period_ns;
    int32_t frozen_after;
    bool started;
    int64_t sample_ns;                     /* time of the last IMU sample */
    uint8_t latest[2 * FIFO_SAMPLES * 12]; /* the IMU of the last call, as it came */
    int32_t repeats;                       /* calls in a row with the same IMU */
    float pressure;                        /* of the last call, as it came */
    float altitude;                        /* the same */
    int64_t battery_ns;
    int64_t flow_ns;  /* of the last flow call; NEVER_NS before */
    real rotation[2]; /* rad, about body x and y, since the last flow */
    real rotation_s;  /* s of it */
    int64_t dropped[DROPPED_COUNT];
} SensorReader;

void sensor_reader_init(SensorReader *self, const LibraryConfig *config, int64_t period_ns);

/* Read one call's acquisition and the flow calls since the last one. */
void sensor_reader_read(SensorReader *self, const uint8_t *acquisition, const FlowCall *calls, int32_t call_count,
                        const FlowGeometry *geometry, int64_t now_ns, Readings *out);

/* Whether the acquisition repeats for too long. */
bool sensor_reader_is_frozen(const SensorReader *self);

/* Number `index` of the floats at `place` of an acquisition. */
float acquisition_float(const uint8_t *acquisition, int32_t place, int32_t index);
uint32_t acquisition_u32(const uint8_t *acquisition, int32_t place);

#endif
