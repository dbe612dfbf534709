/* What an adaptation law gets in one tick: the twin of onboard/control/laws/law.py. A law estimates the disturbance Delta
 * of one channel as nu_ad; the cascade subtracts nu_ad from the demand u. */
#ifndef DMRAC_LAW_H
#define DMRAC_LAW_H

#include <stdbool.h>

#include "control/records.h"
#include "generated/constants.h"

typedef struct {
    real dt;                          /* s */
    bool adapt;                       /* false: change no adaptive state */
    bool saturated;                   /* whether the motors could not meet the last command */
    real tracking_error[6];           /* target minus state; m, m/s or rad, rad/s */
    real model_error[6];              /* e = x_rm - x against the hedged reference model */
    real rate[3];                     /* second half of x: velocity [m/s] or body rates [rad/s] */
    real u_hat[3];                    /* what the actuators deliver: m/s^2 or rad/s^2 */
    real residual[3];                 /* x_dot - A x - B u_hat, unfiltered */
    double lap_phase;                 /* share of the lap flown, in [0, 1); negative while the path does not repeat */
    real lap_s;                       /* duration of a lap, s */
    real signals[SIGNAL_COUNT];       /* at the present */
    real signals_ahead[SIGNAL_COUNT]; /* predicted for t_ahead later; of a law that reads its map on the path, there */
    real signals_path[SIGNAL_COUNT];  /* of such a law only: on the path now */
} ChannelState;

#endif
