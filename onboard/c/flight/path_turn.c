#include "flight/path_turn.h"

#include "generated/constants.h"
#include "numerics/elementary.h"
#include "protocol/geometry.h"

/* path_turn */
void path_turn(const real before[3], const real now[3], const real after[3], PathTurn *out) {
    const real once = REAL(0.5) / TURN_STEP_S, twice = REAL(1.0) / (TURN_STEP_S * TURN_STEP_S);
    const real f[3] = {-now[0], -now[1], real_max(GRAVITY - now[2], FALL_MIN_M_S2)};
    real f_1[3], f_2[3], square = vector_squared_length(f), stretch = REAL(0.0);
    for (int i = 0; i < 3; i++) {
        f_1[i] = once * (before[i] - after[i]);
        f_2[i] = twice * ((now[i] - before[i]) - (after[i] - now[i]));
        stretch += f[i] * f_1[i];
    }
    stretch = REAL(2.0) * stretch / square;
    vector_cross(f, f_1, out->rate);
    vector_cross(f, f_2, out->acceleration);
    for (int i = 0; i < 3; i++) {
        out->rate[i] /= square;
        out->acceleration[i] = out->acceleration[i] / square - stretch * out->rate[i];
    }
}
