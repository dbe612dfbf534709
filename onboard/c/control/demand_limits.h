/* Limits of the position loop: vertical acceleration and tilt. The twin of onboard/control/demand_limits.py, which explains
 * them. */
#ifndef DMRAC_DEMAND_LIMITS_H
#define DMRAC_DEMAND_LIMITS_H

#include "generated/config.h"

typedef struct {
    DemandLimitsConfig config;
    real tilt; /* tangent of the largest tilt */
    bool lifted;
    real lack; /* what the thrust lacks in vertical acceleration, m/s^2; 0 if it lacks nothing */
} DemandLimits;

void demand_limits_init(DemandLimits *self, const DemandLimitsConfig *config);

/* Update with one tick. `adapting`: whether the laws adapted. `residual_z`: vertical acceleration that the delivered thrust
 * does not explain, m/s^2, positive downwards. */
void demand_limits_step(DemandLimits *self, bool adapting, real residual_z, real dt);

/* Start over, as at the beginning of a flight. */
void demand_limits_reset(DemandLimits *self);

/* The specific thrust for the acceleration u, within the limits: m/s^2, world NED, negated. `nu_z`: vertical component of
 * nu_ad. It is part of u; the vertical limits do not apply to it, nor the limit of climb to what lacks beyond it. */
void demand_limits_specific_thrust(const DemandLimits *self, const real u[3], real nu_z, real f[3]);

/* Specific thrust [m/s^2] along the vehicle's axis for the wanted specific thrust f; `axis` is a unit vector. */
real thrust_along(const real f[3], const real axis[3]);

#endif
