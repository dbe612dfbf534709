/* Guidance: the target of each tick from the flight mode, continuous over take-off, path, hold and landing. The twin of
 * onboard/flight/guidance.py. */
#ifndef DMRAC_GUIDANCE_H
#define DMRAC_GUIDANCE_H

#include "control/records.h"
#include "flight/trajectory.h"

typedef struct {
    GuidanceConfig config;
    Path path;
    PathClock clock;
    real origin[3];
    real descent_m;
    real descent_speed; /* m/s */
    real offset[3];     /* m, of the target from the path */
    real return_speed;  /* m/s */
    int32_t resets_seen;
    bool posed;
} Guidance;

void guidance_init(Guidance *self, const GuidanceConfig *config, const Swing *lissajous);

/* Whether the path is over and the landing is due. */
bool guidance_finished(const Guidance *self);

/* Begin a flight above the present position of the vehicle. */
void guidance_start(Guidance *self, const VehicleState *state);

/* Move the target with a jump of the position estimate, if there was one. A first pose (`posed`: a pose has been used)
 * defines the frame: the path moves with it. After any other jump the path stays, and the target returns to it. */
void guidance_follow_jump(Guidance *self, const VehicleState *state, bool posed);

/* Move the path so that its present point is at `position`. */
void guidance_place(Guidance *self, const real position[3]);

/* End a landing: the target stays at `position`. */
void guidance_rest(Guidance *self, const real position[3]);

/* Target of this tick. `run`: path time advances; `landing`: the target descends from where it is; `climbing`: the vehicle
 * has not reached its height, and the path does not begin before. */
void guidance_step(Guidance *self, bool run, bool landing, double seconds, bool climbing, Target *out);

#endif
