#include "control/reference_model.h"

#include <string.h>

#include "numerics/elementary.h"
#include "protocol/geometry.h"

/* ChannelGains.stiffness */
void gains_stiffness(const ChannelGains *gains, real K_1[3]) {
    for (int i = 0; i < 3; i++) {
        real omega_n = gains->natural_frequency_rad_s[i];
        K_1[i] = omega_n * omega_n;
    }
}

/* ChannelGains.rate_gain */
void gains_rate_gain(const ChannelGains *gains, real K_2[3]) {
    for (int i = 0; i < 3; i++) {
        K_2[i] = REAL(2.0) * gains->damping[i] * gains->natural_frequency_rad_s[i];
    }
}

/* PositionReferenceModel.__init__ */
void position_model_init(PositionReferenceModel *self, const ChannelGains *gains) {
    memset(self, 0, sizeof *self);
    gains_stiffness(gains, self->k1);
    gains_rate_gain(gains, self->k2);
}

/* PositionReferenceModel.reset */
void position_model_reset(PositionReferenceModel *self, const real position[3], const real velocity[3]) {
    vector_copy(position, self->position);
    vector_copy(velocity, self->velocity);
}

/* PositionReferenceModel.shift */
void position_model_shift(PositionReferenceModel *self, const real jump[3]) {
    vector_add(self->position, jump, self->position);
}

/* PositionReferenceModel.error */
void position_model_error(const PositionReferenceModel *self, const real position[3], const real velocity[3],
                          real e[6]) {
    vector_subtract(self->position, position, e);
    vector_subtract(self->velocity, velocity, e + 3);
}

/* PositionReferenceModel.step */
void position_model_step(PositionReferenceModel *self, const real command[3], const real hedge[3], real dt) {
    real half = REAL(0.5) * dt * dt;
    for (int i = 0; i < 3; i++) {
        real p = self->position[i], v = self->velocity[i];
        real a = command[i] - self->k1[i] * p - self->k2[i] * v - hedge[i];
        self->position[i] = p + (dt * v + half * a);
        self->velocity[i] = v + dt * a;
    }
}

/* AttitudeReferenceModel.__init__ */
void attitude_model_init(AttitudeReferenceModel *self, const ChannelGains *gains) {
    memset(self, 0, sizeof *self);
    gains_stiffness(gains, self->k1);
    gains_rate_gain(gains, self->k2);
    self->quaternion[0] = self->turn[0] = REAL(1.0);
}

/* AttitudeReferenceModel.reset */
void attitude_model_reset(AttitudeReferenceModel *self, const real quaternion[4], const real rates[3]) {
    memcpy(self->quaternion, quaternion, sizeof self->quaternion);
    vector_copy(rates, self->rates);
    vector_copy(rates, self->vehicle_rates);
    self->turn[0] = REAL(1.0);
    vector_zero(self->turn + 1);
    vector_zero(self->e);
    vector_zero(self->e + 3);
}

/* AttitudeReferenceModel.error */
void attitude_model_error(AttitudeReferenceModel *self, const real quaternion[4], const real rates[3], real e[6]) {
    real inverse[4], omega_rm[3];
    quaternion_conjugate(quaternion, inverse);
    quaternion_multiply(inverse, self->quaternion, self->turn);
    quaternion_to_rotation_vector(self->turn, self->e);
    rotate(self->turn, self->rates, omega_rm);
    vector_subtract(omega_rm, rates, self->e + 3);
    vector_copy(rates, self->vehicle_rates);
    memcpy(e, self->e, sizeof self->e);
}

/* AttitudeReferenceModel.step */
void attitude_model_step(AttitudeReferenceModel *self, const real command[3], const real hedge[3], real dt) {
    const real *e_1 = self->e, *e_2 = self->e + 3;
    real gyration[3], alpha[3], inverse[4];
    vector_cross(self->vehicle_rates, e_2, gyration);
    for (int i = 0; i < 3; i++) {
        alpha[i] = command[i] - hedge[i] - self->k1[i] * e_1[i] - self->k2[i] * e_2[i] + gyration[i];
    }
    quaternion_conjugate(self->turn, inverse);
    rotate(inverse, alpha, alpha); /* alpha_rm */
    real h = REAL(0.5) * dt;
    real turn[4] = {REAL(1.0), REAL(0.0), REAL(0.0), REAL(0.0)};
    for (int i = 0; i < 3; i++) {
        turn[1 + i] = h * (self->rates[i] + h * alpha[i]);
    }
    real *q = self->quaternion;
    quaternion_multiply(q, turn, q);
    real norm = real_sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    for (int i = 0; i < 4; i++) {
        q[i] = q[i] / norm;
    }
    for (int i = 0; i < 3; i++) {
        self->rates[i] = self->rates[i] + dt * alpha[i];
    }
}
