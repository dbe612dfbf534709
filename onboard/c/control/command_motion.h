/* The motion of the commanded attitude as it is fed forward. The twin of onboard/control/command_motion.py, which explains
 * it. */
#ifndef DMRAC_COMMAND_MOTION_H
#define DMRAC_COMMAND_MOTION_H

#include "control/records.h"

/* Body FRD; zero on the ground. */
typedef struct {
    real filter_s; /* s, on what feedback adds to the rate; 0: that is not fed forward */
    real share;    /* of the path's turn that is fed forward */
    real commanded[4];
    real added_rate[3];
    real turn[3];    /* of the commanded attitude since the last tick, rad */
    real omega_d[3]; /* rad/s */
    real alpha_d[3]; /* rad/s^2 */
} CommandMotion;

void command_motion_init(CommandMotion *self, real filter_s, real path_turn);

/* Update with the attitude commanded in this tick. */
void command_motion_step(CommandMotion *self, const real commanded[4], const ControlInputs *inputs);

#endif
