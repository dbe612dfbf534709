/* How the thrust of a path turns. The twin of onboard/flight/path_turn.py, which explains it. */
#ifndef DMRAC_PATH_TURN_H
#define DMRAC_PATH_TURN_H

#include "numerics/real.h"

/* World NED. */
typedef struct {
    real rate[3];         /* rad/s */
    real acceleration[3]; /* rad/s^2 */
} PathTurn;

/* The turn, from the path's acceleration [m/s^2, world NED] TURN_STEP_S before, at the present, and TURN_STEP_S after. */
void path_turn(const real before[3], const real now[3], const real after[3], PathTurn *out);

#endif
