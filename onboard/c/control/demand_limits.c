#include "control/demand_limits.h"

#include "generated/constants.h"
#include "numerics/elementary.h"
#include "protocol/geometry.h"

/* DemandLimits.__init__ */
void demand_limits_init(DemandLimits *self, const DemandLimitsConfig *config) {
    self->config = *config;
    self->tilt = real_tan(config->tilt_max_rad);
    demand_limits_reset(self);
}

/* DemandLimits.step */
void demand_limits_step(DemandLimits *self, bool adapting, real residual_z, real dt) {
    real share = real_min(dt / self->config.lack_filter_s, REAL(1.0));
    self->lifted = self->lifted || adapting;
    self->lack = real_max(REAL(0.0), self->lack + (residual_z - self->lack) * share);
}

/* DemandLimits.reset */
void demand_limits_reset(DemandLimits *self) {
    self->lack = REAL(0.0);
    self->lifted = false;
}

/* DemandLimits.specific_thrust */
void demand_limits_specific_thrust(const DemandLimits *self, const real u[3], real nu_z, real f[3]) {
    const DemandLimitsConfig *config = &self->config;
    real climb = self->lifted ? config->climb_acceleration_max_m_s2 : config->take_off_acceleration_max_m_s2;
    climb += real_max(self->lack - real_max(nu_z, REAL(0.0)), REAL(0.0));
    real uz = real_clip(u[2] + nu_z, -climb, config->sink_acceleration_max_m_s2) - nu_z;
    real fx = -u[0], fy = -u[1], fz = real_max(GRAVITY - uz, FALL_MIN_M_S2);
    real horizontal = real_sqrt(fx * fx + fy * fy), most = fz * self->tilt;
    if (horizontal > most) {
        fx = fx * most / horizontal;
        fy = fy * most / horizontal;
    }
    f[0] = fx;
    f[1] = fy;
    f[2] = fz;
}

/* thrust_along */
real thrust_along(const real f[3], const real axis[3]) {
    real z = axis[2];
    real along = f[0] * axis[0] + f[1] * axis[1] + f[2] * z;
    real cosine = along / vector_length(f);
    if (cosine >= ASTRAY_COSINE_0 || z <= REAL(0.0)) {
        return real_max(along, REAL(0.0));
    }
    real upright = z > UPRIGHT_MIN ? f[2] / z : f[2] * z / (UPRIGHT_MIN * UPRIGHT_MIN);
    real share = real_min((ASTRAY_COSINE_0 - cosine) / (ASTRAY_COSINE_0 - ASTRAY_COSINE_1), REAL(1.0));
    return real_max(along + share * real_max(upright - along, REAL(0.0)), REAL(0.0));
}
