/* Hedged reference models: the motion of the vehicle if its disturbances were cancelled exactly. The twin of
 * onboard/control/reference_model.py.
 *
 *     x_rm_dot = A_rm x_rm + B K_r r - B (u - u_hat)
 */
#ifndef DMRAC_REFERENCE_MODEL_H
#define DMRAC_REFERENCE_MODEL_H

#include "generated/config.h"

/* omega_n^2 of each axis. */
void gains_stiffness(const ChannelGains *gains, real K_1[3]);

/* 2 zeta omega_n of each axis. */
void gains_rate_gain(const ChannelGains *gains, real K_2[3]);

/* Position and velocity, world NED. */
typedef struct {
    real k1[3];
    real k2[3];
    real position[3]; /* m */
    real velocity[3]; /* m/s */
} PositionReferenceModel;

void position_model_init(PositionReferenceModel *self, const ChannelGains *gains);

/* Set the reference to the vehicle's state. */
void position_model_reset(PositionReferenceModel *self, const real position[3], const real velocity[3]);

/* Move with a jump of the position estimate, which is no motion. */
void position_model_shift(PositionReferenceModel *self, const real jump[3]);

/* e = x_rm - x [6] against the vehicle's position and velocity, m and m/s. */
void position_model_error(const PositionReferenceModel *self, const real position[3], const real velocity[3],
                          real e[6]);

/* Advance one period: v_rm_dot = K_r r - K_1 p_rm - K_2 v_rm - (u - u_hat). `command` is K_r r, `hedge` u - u_hat. */
void position_model_step(PositionReferenceModel *self, const real command[3], const real hedge[3], real dt);

/* Attitude and body rates of the reference, and the error e against the vehicle's: e_1 the rotation vector from the
 * vehicle to the reference, e_2 = R(e_1) omega_rm - omega. */
typedef struct {
    real k1[3];
    real k2[3];
    real quaternion[4];
    real rates[3]; /* rad/s, in the axes of the reference */
    real turn[4];
    real e[6];
    real vehicle_rates[3];
} AttitudeReferenceModel;

void attitude_model_init(AttitudeReferenceModel *self, const ChannelGains *gains);

/* Set the reference to the vehicle's attitude and rates. */
void attitude_model_reset(AttitudeReferenceModel *self, const real quaternion[4], const real rates[3]);

/* e = [e_1; e_2] against the vehicle's attitude and rates, rad and rad/s. */
void attitude_model_error(AttitudeReferenceModel *self, const real quaternion[4], const real rates[3], real e[6]);

/* Advance one period: omega_rm_dot = R(e_1)' (K_r r - K x - (u - u_hat) - K e + omega x e_2), with the vehicle of the last
 * call of attitude_model_error. `command` is K_r r - K x in the vehicle's axes, `hedge` u - u_hat, both rad/s^2. */
void attitude_model_step(AttitudeReferenceModel *self, const real command[3], const real hedge[3], real dt);

#endif
