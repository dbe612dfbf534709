#include "control/laws/path_gap.h"

#include <stddef.h>

#include "protocol/geometry.h"

/* PathGap.close */
void gap_close(PathGap *self, const real *deviation) {
    vector_zero(self->error);
    vector_zero(self->rate);
    if (deviation != NULL) {
        vector_copy(deviation, self->values);
    } else {
        vector_zero(self->values);
    }
}

/* PathGap.step */
void gap_step(PathGap *self, const TrackingWeights *PB, const real deviation[3], real share, real keep, real t,
              real dt) {
    for (int axis = 0; axis < 3; axis++) {
        real m = deviation[axis], *error = self->error + axis, *rate = self->rate + axis;
        real pull = dt * (self->values[axis] - m - PB->K_1[axis] * *error);
        *rate =
            (*rate + pull) / (REAL(1.0) + dt * (PB->K_2[axis] + dt * PB->K_1[axis])); /* implicit: stable at any dt */
        *error += dt * *rate;
        real kept = keep * self->values[axis];
        self->values[axis] = kept + share * (m - kept - t * (PB->e_1[axis] * *error + PB->e_2[axis] * *rate));
    }
}
