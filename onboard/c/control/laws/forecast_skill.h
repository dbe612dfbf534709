/* How far the changes of a map have come true. The twin of onboard/control/laws/forecast_skill.py, which explains it:
 *
 *     g = sum r' m' / (sum m'^2 + R)     in each axis, within 0 to 1 */
#ifndef DMRAC_FORECAST_SKILL_H
#define DMRAC_FORECAST_SKILL_H

#include <stdbool.h>

#include "numerics/real.h"

typedef struct {
    real shares[3]; /* g */
    real slow_residual[3];
    real slow_map[3];
    real agreed[3]; /* sum r' m' */
    real moved[3];  /* sum m'^2 */
    bool continues;
} ForecastSkill;

/* Another map follows. */
void skill_restart(ForecastSkill *self);

/* One tick: `of_map` is W'Phi at the present state, before this residual corrected W. */
void skill_step(ForecastSkill *self, real noise_variance, const real residual[3], const real of_map[3], real dt);

/* on_path + g (ahead - on_path) */
void skill_apply(const ForecastSkill *self, const real on_path[3], const real ahead[3], real out[3]);

#endif
