/* Trajectories: paths with smooth starts, and the path clock. The twin of onboard/flight/trajectory.py. Path time is a
 * double in both number types: it grows for the whole flight. */
#ifndef DMRAC_TRAJECTORY_H
#define DMRAC_TRAJECTORY_H

#include <stdbool.h>

#include "generated/config.h"

/* Target at one instant, world NED. */
typedef struct {
    real position[3];     /* m */
    real velocity[3];     /* m/s */
    real acceleration[3]; /* m/s^2 */
} PathPoint;

/* A straight way between two waypoints. */
typedef struct {
    real start_s;
    real moving_s;
    real origin[3]; /* m, from the hover point */
    real step[3];   /* m */
} Leg;

/* A path relative to the point where the vehicle took off, as a pure function of path time. */
typedef struct {
    TrajectoryConfig config;
    Swing lissajous[2]; /* north and east */
    double start_s;
    Leg legs[POINTS_M_MAX];
    int32_t leg_count;
    real omega; /* rad/s, of a periodic path */
    real theta; /* rad, where it begins */
    bool begins_elsewhere;
    real begin[2]; /* m, north and east of the take-off point */
} Path;

/* Quintic 0..1 with zero velocity and acceleration at both ends: value, first and second derivative in s. */
void smooth_step(real s, real out[3]);

/* `lissajous`: the motions along both axes, drawn by the seed; unused on other paths. */
void path_init(Path *self, const TrajectoryConfig *config, const Swing *lissajous);

/* Path time at which the first lap at full speed begins, s. */
double path_laps_from_s(const Path *self);

/* Period of one lap, s; 0 for a path without laps. */
real path_lap_s(const Path *self);

/* Share of the lap flown at path time t, in [0, 1); -1 before the first full lap and on a path without laps. */
double path_lap_phase(const Path *self, double t);

/* Target at path time t [s], relative to the take-off point on the floor. */
void path_at(const Path *self, double t, PathPoint *out);

/* Path time. Its rate changes between 0 and 1 within `ease_s`, so the target's velocity never jumps. */
typedef struct {
    real ease_s;
    real stop_s; /* path time that still passes when a running clock is stopped */
    real x;
    double time_s;
    real rate;
    real rate_change; /* d rate / dt, 1/s */
} PathClock;

void path_clock_init(PathClock *self);

/* Advance by dt [s]; `run`: whether path time runs. */
void path_clock_step(PathClock *self, bool run, double dt);

/* Whether path time runs like real time. */
bool path_clock_steady(const PathClock *self);

/* Make the derivatives of a point those in real time, at the present rate of the clock. */
void path_clock_ahead(const PathClock *self, PathPoint *point);

#endif
