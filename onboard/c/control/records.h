/* Inputs and outputs of a controller: the twin of onboard/control/records.py. */
#ifndef DMRAC_RECORDS_H
#define DMRAC_RECORDS_H

#include "numerics/real.h"

/* What the actuators do in one channel, and what they do not explain; m/s^2 (world NED) or rad/s^2 (body FRD). */
typedef struct {
    real u_hat[3];    /* acceleration that the actuators deliver */
    real residual[3]; /* measured acceleration minus u_hat, unfiltered */
} ChannelMeasurement;

/* What one channel did in a tick, for the log; zeros where a controller has no such quantity. */
typedef struct {
    real error[6];        /* e = x_rm - x; m, m/s or rad, rad/s */
    real demand[3];       /* u: m/s^2 or rad/s^2 */
    real adaptive[3];     /* nu_ad as commanded (evaluated ahead) */
    real adaptive_now[3]; /* nu_ad of the present state, W'Phi(x) */
    real residual[3];     /* Delta_hat */
    real weight_norm;
    real eps_1;
    real eps_2;
    real eps_3;
    real tracking_bound; /* live bound on the tracking error, m or rad; 0 without one */
} ChannelTelemetry;

#endif
