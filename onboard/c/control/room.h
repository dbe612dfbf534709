/* The room for nu_ad: what the actuators can give in each axis beside what the loop itself needs. The twin of
 * onboard/control/room.py, which explains it.
 *
 *     room = max(share (reach - |need|), least reach) */
#ifndef DMRAC_ROOM_H
#define DMRAC_ROOM_H

#include "generated/config.h"

/* Bounds of nu_ad, per axis. */
typedef struct {
    RoomConfig config;
    AirframeConfig airframe;
    real level; /* reach to north and east, m/s^2 */
} Room;

void room_init(Room *self, const RoomConfig *config, const AirframeConfig *airframe, real tilt_max_rad);

/* Bound of |nu_ad| for each axis, m/s^2, world NED. `need`: the demand of the loop without the law, m/s^2. */
void room_position(const Room *self, real thrust_scale, const real need[3], real room[3]);

/* Bound of |nu_ad| for each axis, rad/s^2, body FRD, at a collective thrust, N. `need`: rad/s^2. */
void room_attitude(const Room *self, real thrust_scale, real thrust_n, const real need[3], real room[3]);

#endif
