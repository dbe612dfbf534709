/* A live bound on the tracking error of both channels, m and rad, for every law of the cascade. The twin of
 * onboard/control/tracking_bound.py, which explains it. The tracking error d of an axis obeys
 *
 *     d_ddot + 2 zeta omega d_dot + omega^2 d = w = a_d - u_hat - Delta + 2 zeta omega d_dot + omega^2 d */
#ifndef DMRAC_TRACKING_BOUND_H
#define DMRAC_TRACKING_BOUND_H

#include "control/command_motion.h"
#include "control/records.h"
#include "generated/config.h"

/* gain (exp(-slow t) - exp(-fast t)) / (fast - slow) >= |h1(t)|; gain t exp(-slow t) for equal poles. */
typedef struct {
    real fast; /* 1/s */
    real slow; /* 1/s */
    real gain;
} Majorant;

/* The majorant of h1 of one axis: h1 itself for zeta >= 1, else the one of two forms with the smaller integral. */
void majorant(real omega, real zeta, Majorant *out);

/* The bound of one axis. */
typedef struct {
    real k1;
    real k2;
    Majorant majorant;
    real z1;
    real z2;
    real once;  /* the residual through F */
    real twice; /* through F twice; Delta_hat = 2 once - twice */
    real pull;  /* a_d + k1 d + k2 d_rate of the last tick */
    real response;
    real response_rate;
    real keep1;
    real keep2;
    real feed1;
    real feed2;
    real pass2;
    real share;
} AxisBound;

/* The live bounds of both channels. They start anew whenever the laws do not adapt. */
typedef struct {
    AxisBound position[3];
    AxisBound attitude[3];
    real period;
    bool running;
    int32_t resets_seen;
    real velocity[3];
} TrackingBounds;

void tracking_bounds_init(TrackingBounds *self, const ChannelGains *position, const ChannelGains *attitude);

/* Start anew at the next step. */
void tracking_bounds_reset(TrackingBounds *self);

/* The bounds of this tick, position [m] and attitude [rad]; 0 while the laws do not adapt. `commanded`: the commanded
 * attitude of this tick. `motion`: of that, and what of it is fed forward. */
void tracking_bounds_step(TrackingBounds *self, const ControlInputs *inputs, const real commanded[4],
                          const CommandMotion *motion, real bounds[2]);

#endif
