/* The record of one tick, in one flat vector: the twin of onboard/record/tick.py, which names the fields. Numbers are
 * doubles in both number types, as in the log. */
#ifndef DMRAC_TICK_H
#define DMRAC_TICK_H

#include "control/records.h"
#include "generated/constants.h"
#include "generated/modes.h"

/* Fields of a record: those of the vehicle, then those of two channels, which have as many each. */
#define TICK_FIELDS (2 * TICK_ATTITUDE_AT - TICK_POSITION_AT)

/* What a tick records beside inputs and output of the controller. Ages: -1 for never. */
typedef struct {
    FlightMode mode;
    bool saturated; /* the motors cannot deliver what the controller demands in this tick */
    double path_time_s;
    int64_t feature_version;
    double feature_age_s;
    double pose_age_s;
    double offboard_age_s;
    real battery_v;
    const real *motors;          /* [4], commanded, shares of the maximum thrust */
    const real *motor_thrusts_n; /* [4], N, by the actuator model */
} TickContext;

/* `row`: TICK_FIELDS numbers. */
void write_tick(double *row, const ControlInputs *inputs, const ControlOutput *control, const TickContext *context);

/* Seconds since `then_ns`; -1 if it has never happened. */
double age_s(int64_t now_ns, int64_t then_ns);

#endif
