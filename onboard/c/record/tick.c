#include "record/tick.h"

/* Appends numbers to a row; returns the place behind them. */
static double *put(double *at, const real *values, int count) {
    for (int i = 0; i < count; i++) {
        *at++ = (double)values[i];
    }
    return at;
}

/* _write_channel */
static double *put_channel(double *at, const ChannelTelemetry *telemetry, const ChannelMeasurement *measured) {
    at = put(at, telemetry->error, 6);
    at = put(at, telemetry->demand, 3);
    at = put(at, measured->u_hat, 3);
    at = put(at, telemetry->adaptive, 3);
    at = put(at, telemetry->adaptive_now, 3);
    at = put(at, telemetry->residual, 3);
    at = put(at, telemetry->room, 3);
    const real numbers[5] = {telemetry->weight_norm, telemetry->eps_1, telemetry->eps_2, telemetry->eps_3,
                             telemetry->tracking_bound};
    return put(at, numbers, 5);
}

/* write_tick */
void write_tick(double *row, const ControlInputs *inputs, const ControlOutput *control, const TickContext *context) {
    const VehicleState *state = inputs->state;
    const Target *target = inputs->target;
    double *at = row;
    *at++ = (double)context->mode;
    *at++ = (double)inputs->adapt;
    *at++ = (double)context->saturated;
    *at++ = context->path_time_s;
    *at++ = (double)context->feature_version;
    *at++ = context->feature_age_s;
    *at++ = context->pose_age_s;
    *at++ = context->offboard_age_s;
    const real numbers[5] = {context->battery_v, state->vibration, state->position_sigma_m, control->thrust_n,
                             inputs->thrust_scale};
    at = put(at, numbers, 5);
    *at++ = (double)control->law;
    at = put(at, state->position, 3);
    at = put(at, state->velocity, 3);
    at = put(at, state->quaternion, 4);
    at = put(at, state->euler, 3);
    at = put(at, state->rates, 3);
    at = put(at, target->path.position, 3);
    at = put(at, target->path.velocity, 3);
    at = put(at, target->feed_forward, 3);
    at = put(at, control->commanded_quaternion, 4);
    at = put(at, control->torque_nm, 3);
    at = put(at, context->motors, 4);
    put(at, context->motor_thrusts_n, 4);
    at = put_channel(row + TICK_POSITION_AT, &control->position, inputs->position);
    put_channel(at, &control->attitude, inputs->attitude);
}

/* age_s */
double age_s(int64_t now_ns, int64_t then_ns) {
    return then_ns == NEVER_NS ? -1.0 : (double)(now_ns - then_ns) * 1e-9;
}
