/* Inputs and outputs of a controller: the twin of onboard/control/records.py. */
#ifndef DMRAC_RECORDS_H
#define DMRAC_RECORDS_H

#include "numerics/real.h"

/* What the actuators do in one channel, and what they do not explain; m/s^2 (world NED) or rad/s^2 (body FRD). */
typedef struct {
    real u_hat[3];    /* acceleration that the actuators deliver */
    real residual[3]; /* measured acceleration minus u_hat, unfiltered */
} ChannelMeasurement;

#endif
