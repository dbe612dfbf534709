/* Fills the signal vector from state estimate and actuator model: the twin of onboard/sampling/signal_vector.py. */
#ifndef DMRAC_SIGNAL_VECTOR_H
#define DMRAC_SIGNAL_VECTOR_H

#include "estimation/state.h"
#include "generated/constants.h"

typedef struct {
    real values[SIGNAL_COUNT];
    real share; /* of the filter of the motor thrusts */
} SignalVector;

void signal_vector_init(SignalVector *self, real period_s);

/* The signals at the present are `values`. motor_thrusts: N, by the actuator model. */
void signal_vector_step(SignalVector *self, const VehicleState *state, const real motor_thrusts[4], real battery_v);

#endif
