#include "control/uncertainty.h"

#include "generated/constants.h"
#include "protocol/geometry.h"

/* UncertaintyMeasurement.__init__ */
void uncertainty_init(UncertaintyMeasurement *self, const AirframeConfig *airframe, real period_s) {
    *self = (UncertaintyMeasurement){.airframe = *airframe, .dt = period_s};
}

/* UncertaintyMeasurement._angular_acceleration: J^-1 (tau - omega x J omega) */
static void angular_acceleration(const UncertaintyMeasurement *self, const real tau[3], const real rates[3],
                                 real out[3]) {
    real Jx = self->airframe.inertia_kg_m2[0], Jy = self->airframe.inertia_kg_m2[1];
    real Jz = self->airframe.inertia_kg_m2[2];
    real p = rates[0], q = rates[1], r = rates[2];
    out[0] = (tau[0] - (Jz - Jy) * q * r) / Jx;
    out[1] = (tau[1] - (Jx - Jz) * p * r) / Jy;
    out[2] = (tau[2] - (Jy - Jx) * p * q) / Jz;
}

/* UncertaintyMeasurement._translation: u_hat = g e_3 - (T / m) R e_3;  r = R f + (T_last / m) R e_3, f the specific force
 * of the last period */
static void translation(UncertaintyMeasurement *self, const VehicleState *state, real T, real T_last) {
    real lift = -T / self->airframe.mass_kg, last_lift = -T_last / self->airframe.mass_kg;
    const real *f = state->specific_force;
    for (int axis = 0; axis < 3; axis++) {
        const real *R = state->rotation + 3 * axis;
        self->position.u_hat[axis] = lift * R[2];
        self->position.residual[axis] = R[0] * f[0] + R[1] * f[1] + R[2] * f[2] - last_lift * R[2];
    }
    self->position.u_hat[2] += GRAVITY;
}

/* UncertaintyMeasurement._rotation: u_hat = J^-1 (tau - omega x J omega);  r = omega_dot - u_hat, over the time `dt`
 * since the last tick */
static void rotation(UncertaintyMeasurement *self, const VehicleState *state, const real tau[3], real dt) {
    real u[3];
    angular_acceleration(self, tau, state->rates, u);
    for (int axis = 0; axis < 3; axis++) {
        self->attitude.u_hat[axis] = u[axis];
        self->attitude.residual[axis] = (state->rates[axis] - self->last_rates[axis]) / dt - u[axis];
    }
    vector_copy(state->rates, self->last_rates);
}

/* UncertaintyMeasurement.step */
void uncertainty_step(UncertaintyMeasurement *self, const VehicleState *state, const Delivered *passed,
                      int32_t periods) {
    real mean[4] = {0}, latest = REAL(0.0);
    for (int k = 0; k < periods; k++) {
        const real now[4] = {passed[k].thrust_n, passed[k].torque_nm[0], passed[k].torque_nm[1],
                             passed[k].torque_nm[2]};
        latest = REAL(0.5) * (self->last_delivered[0] + now[0]);
        for (int i = 0; i < 4; i++) {
            mean[i] += REAL(0.5) * (self->last_delivered[i] + now[i]);
            self->last_delivered[i] = now[i];
        }
    }
    for (int i = 0; i < 4; i++) {
        mean[i] /= (real)periods;
    }
    translation(self, state, mean[0], latest);
    rotation(self, state, mean + 1, self->dt * (real)periods);
}

/* UncertaintyMeasurement.coming */
void uncertainty_coming(const UncertaintyMeasurement *self, const VehicleState *state, const Delivered *delivered,
                        const Delivered *ahead, real now[3], real later[3]) {
    angular_acceleration(self, delivered->torque_nm, state->rates, now);
    angular_acceleration(self, ahead->torque_nm, state->rates, later);
}
