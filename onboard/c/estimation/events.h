/* Events of the estimator. onboard/c/event_text.py makes numpy's text of them. */
#ifndef DMRAC_ESTIMATOR_EVENTS_H
#define DMRAC_ESTIMATOR_EVENTS_H

#include <stdint.h>

#include "generated/constants.h"

/* What corrects the filter. */
typedef enum { AID_FLOW, AID_RANGE, AID_PRESSURE, AID_POSE_POSITION, AID_POSE_ATTITUDE } Aid;
#define AID_COUNT 5

typedef enum {
    ESTIMATOR_JUMPED,         /* by `number`, an Aid; values: length, m */
    ESTIMATOR_WIDENED,        /* for `number`, an Aid */
    ESTIMATOR_GAP,            /* values: s without IMU samples */
    ESTIMATOR_FOUND_ATTITUDE, /* values: roll, pitch, rad */
    ESTIMATOR_GYRO_STUCK,     /* `number`: axis */
    ESTIMATOR_CALIBRATED,     /* values: gyroscope bias, accelerometer along gravity, s */
    ESTIMATOR_MOVED,          /* `number`: 0 to 2 accelerometer, 3 to 5 gyroscope; values: change */
    ESTIMATOR_BIASED,         /* `number`: axis; values: bias and its limit, rad/s */
    ESTIMATOR_POSES_DRIFT     /* values: by how much, m */
} EstimatorEventKind;

typedef struct {
    int64_t time_ns;
    EstimatorEventKind kind;
    int32_t number;
    real values[5];
} EstimatorEvent;

typedef struct {
    EstimatorEvent events[ESTIMATOR_EVENTS_MAX + 1]; /* the last one takes what is lost */
    int32_t count;
} EstimatorEvents;

/* Add an event; beyond the limit it is lost. Returns it, for its values. */
EstimatorEvent *estimator_report(EstimatorEvents *self, int64_t time_ns, EstimatorEventKind kind, int32_t number);

#endif
