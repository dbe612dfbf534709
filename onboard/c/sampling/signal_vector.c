#include "sampling/signal_vector.h"

#include "numerics/elementary.h"
#include "protocol/geometry.h"

/* SignalVector.__init__ */
void signal_vector_init(SignalVector *self, real period_s) {
    *self = (SignalVector){.share = REAL(1.0) - real_exp(-period_s / THRUST_FILTER_S)};
}

/* SignalVector.step */
void signal_vector_step(SignalVector *self, const VehicleState *state, const real motor_thrusts[4], real battery_v) {
    real *v = self->values;
    vector_copy(state->position, v + SIGNAL_POSITION_N);
    vector_copy(state->velocity, v + SIGNAL_VELOCITY_N);
    vector_copy(state->euler, v + SIGNAL_ROLL);
    vector_copy(state->rates, v + SIGNAL_RATE_P);
    matrix_transposed_times(state->rotation, state->velocity, v + SIGNAL_BODY_VELOCITY_X);
    for (int i = 0; i < 4; i++) {
        real *thrust = v + SIGNAL_MOTOR_THRUST_1 + i;
        *thrust += self->share * (motor_thrusts[i] - *thrust);
    }
    v[SIGNAL_BATTERY_VOLTAGE] = battery_v;
    v[SIGNAL_VIBRATION] = state->vibration;
}
