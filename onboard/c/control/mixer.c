#include "control/mixer.h"

#include "numerics/elementary.h"

/* Mixer.__init__ */
void mixer_init(Mixer *self, const AirframeConfig *config) {
    self->config = *config;
    self->scale = REAL(1.0);
    self->x = REAL(0.25) / config->arm_x_m;
    self->y = REAL(0.25) / config->arm_y_m;
    self->z = REAL(0.25) / config->yaw_torque_per_thrust_m;
}

/* Mixer.thrusts */
void mixer_thrusts(const Mixer *self, real thrust_n, const real torque_nm[3], real thrusts[4]) {
    real high = self->scale * self->config.motor_thrust_max_n;
    real low = self->config.motor_thrust_min_share * high;
    real roll = torque_nm[0] * self->y, pitch = torque_nm[1] * self->x, yaw = torque_nm[2] * self->z;
    /* Roll and pitch first: shrink them together only if their own spread exceeds the range. */
    real spread = REAL(2.0) * (real_abs(roll) + real_abs(pitch));
    if (spread > high - low) {
        roll *= (high - low) / spread;
        pitch *= (high - low) / spread;
    }
    /* Roll and pitch separate motors 1, 2 by +-first and 3, 4 by +-second; yaw raises one pair, lowers the other. */
    real first = pitch - roll, second = pitch + roll;
    real raised = real_abs(yaw < REAL(0.0) ? second : first);
    real lowered = real_abs(yaw < REAL(0.0) ? first : second);
    real turn = real_abs(yaw), middle = REAL(0.5) * (raised + lowered);
    /* The range of mean thrust where some part of the yaw, from none to all, keeps every motor within its limits. */
    real lowest = real_max(real_max(low + lowered, low + raised - turn), low + middle);
    real highest = real_min(real_min(high - raised, high - lowered + turn), high - middle);
    real base = real_min(real_max(REAL(0.25) * thrust_n, lowest), highest);
    turn = real_max(real_min(real_min(turn, high - base - raised), base - lowered - low), REAL(0.0));
    if (yaw < REAL(0.0)) {
        turn = -turn;
    }
    thrusts[0] = base + first + turn;
    thrusts[1] = base - first + turn;
    thrusts[2] = base + second - turn;
    thrusts[3] = base - second - turn;
}

/* Mixer.falls_short */
bool mixer_falls_short(const Mixer *self, const real thrusts[4], real thrust_n, const real torque_nm[3]) {
    real delivered[4];
    wrench(&self->config, thrusts, delivered);
    return real_abs(delivered[0] - thrust_n) > REAL(1e-3) || real_abs(delivered[1] - torque_nm[0]) > REAL(1e-5) ||
           real_abs(delivered[2] - torque_nm[1]) > REAL(1e-5);
}

/* wrench */
void wrench(const AirframeConfig *config, const real thrusts[4], real out[4]) {
    real t1 = thrusts[0], t2 = thrusts[1], t3 = thrusts[2], t4 = thrusts[3];
    out[0] = t1 + t2 + t3 + t4;
    out[1] = config->arm_y_m * (t2 + t3 - t1 - t4);
    out[2] = config->arm_x_m * (t1 + t3 - t2 - t4);
    out[3] = config->yaw_torque_per_thrust_m * (t1 + t2 - t3 - t4);
}
