/* What the actuators deliver (u_hat) and what they do not explain (the residual), in both channels. The twin of
 * onboard/control/uncertainty.py.
 *
 *     r = x_dot - A x - u_hat          (the three rows that B selects)
 */
#ifndef DMRAC_UNCERTAINTY_H
#define DMRAC_UNCERTAINTY_H

#include "control/actuators.h"
#include "control/records.h"
#include "estimation/state.h"

typedef struct {
    AirframeConfig airframe;
    real dt;                     /* s */
    ChannelMeasurement position; /* m/s^2, world NED */
    ChannelMeasurement attitude; /* rad/s^2, body FRD */
    real last_rates[3];
    real last_delivered[4];
} UncertaintyMeasurement;

void uncertainty_init(UncertaintyMeasurement *self, const AirframeConfig *airframe, real period_s);

/* Position and attitude channel at the present. `passed` [periods]: thrust and torque at the end of each period since the
 * last tick: one, or more if ticks were missed. Their mean has moved the vehicle since then. */
void uncertainty_step(UncertaintyMeasurement *self, const VehicleState *state, const Delivered *passed,
                      int32_t periods);

/* Angular acceleration by the actuators now and one tick later, rad/s^2, at the present rates. */
void uncertainty_coming(const UncertaintyMeasurement *self, const VehicleState *state, const Delivered *delivered,
                        const Delivered *ahead, real now[3], real later[3]);

#endif
