#include "control/laws/forecast_skill.h"

#include "generated/constants.h"
#include "numerics/elementary.h"
#include "protocol/geometry.h"

/* ForecastSkill.restart */
void skill_restart(ForecastSkill *self) {
    self->continues = false;
}

/* ForecastSkill.step */
void skill_step(ForecastSkill *self, real noise_variance, const real residual[3], const real of_map[3], real dt) {
    real share = dt / (SKILL_SLOW_S + dt), keep = SKILL_MEMORY_S / (SKILL_MEMORY_S + dt), least = noise_variance * dt;
    if (!self->continues) {
        vector_copy(of_map, self->slow_map);
        self->continues = true;
    }
    for (int axis = 0; axis < 3; axis++) {
        real fast_residual = residual[axis] - self->slow_residual[axis];
        real fast_map = of_map[axis] - self->slow_map[axis];
        self->slow_residual[axis] += share * fast_residual;
        self->slow_map[axis] += share * fast_map;
        self->agreed[axis] = keep * (self->agreed[axis] + dt * fast_residual * fast_map);
        self->moved[axis] = keep * (self->moved[axis] + dt * fast_map * fast_map);
        real share_true = self->agreed[axis] / (self->moved[axis] + least);
        self->shares[axis] = real_clip(share_true, REAL(0.0), REAL(1.0));
    }
}

/* KalmanLastLayer.look_ahead */
void skill_apply(const ForecastSkill *self, const real on_path[3], const real ahead[3], real out[3]) {
    for (int axis = 0; axis < 3; axis++) {
        out[axis] = on_path[axis] + self->shares[axis] * (ahead[axis] - on_path[axis]);
    }
}
