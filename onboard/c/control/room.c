#include "control/room.h"

#include "generated/constants.h"
#include "numerics/elementary.h"

/* Room.__init__ */
void room_init(Room *self, const RoomConfig *config, const AirframeConfig *airframe, real tilt_max_rad) {
    self->config = *config;
    self->airframe = *airframe;
    self->level = GRAVITY * real_tan(tilt_max_rad);
}

/* Room._room */
static void room_of(const Room *self, int channel, const real reach[3], const real need[3], real room[3]) {
    real share = self->config.share[channel], least = self->config.least[channel];
    for (int axis = 0; axis < 3; axis++) {
        room[axis] = real_max(share * (reach[axis] - real_abs(need[axis])), least * reach[axis]);
    }
}

/* Room.position */
void room_position(const Room *self, real thrust_scale, const real need[3], real room[3]) {
    real most = REAL(4.0) * thrust_scale * self->airframe.motor_thrust_max_n / self->airframe.mass_kg;
    real down = real_max(real_min(most - GRAVITY, GRAVITY - FALL_MIN_M_S2), REAL(0.0));
    const real reach[3] = {self->level, self->level, down};
    room_of(self, 0, reach, need, room);
}

/* Room.attitude */
void room_attitude(const Room *self, real thrust_scale, real thrust_n, const real need[3], real room[3]) {
    const AirframeConfig *airframe = &self->airframe;
    real high = thrust_scale * airframe->motor_thrust_max_n;
    real low = airframe->motor_thrust_min_share * high;
    real each = REAL(0.25) * thrust_n;
    real spread = REAL(4.0) * real_max(real_min(each - low, high - each), REAL(0.25) * (high - low));
    const real arm[3] = {airframe->arm_y_m, airframe->arm_x_m, airframe->yaw_torque_per_thrust_m};
    real reach[3];
    for (int axis = 0; axis < 3; axis++) {
        reach[axis] = spread * arm[axis] / airframe->inertia_kg_m2[axis];
    }
    room_of(self, 1, reach, need, room);
}
