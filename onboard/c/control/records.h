/* Inputs and outputs of a controller: the twin of onboard/control/records.py. */
#ifndef DMRAC_RECORDS_H
#define DMRAC_RECORDS_H

#include <stdbool.h>

#include "estimation/state.h"
#include "flight/path_turn.h"
#include "flight/trajectory.h"
#include "numerics/real.h"

/* The target of one tick, world NED. */
typedef struct {
    PathPoint now;            /* at the present */
    real feed_forward[3];     /* m/s^2: acceleration of the path t_ff ahead */
    PathPoint ahead;          /* t_ahead from now, for the look-ahead of the position channel */
    PathPoint attitude_ahead; /* the same for the attitude channel, with a shorter t_ahead */
    real yaw_rad;
    PathPoint path; /* the path itself: `now` without the way back to the path after a jump of the position estimate */
    PathTurn turn;  /* how the thrust of the path turns t_ff ahead */
    double lap_phase; /* share of the lap flown, in [0, 1); negative while the path does not repeat */
    real lap_s;       /* duration of a lap, s; 0 for a path without laps */
} Target;

/* What the actuators do in one channel, and what they do not explain; m/s^2 (world NED) or rad/s^2 (body FRD). */
typedef struct {
    real u_hat[3];    /* acceleration that the actuators deliver */
    real residual[3]; /* measured acceleration minus u_hat, unfiltered */
} ChannelMeasurement;

/* Inputs of a controller in one tick. numpy's has an excitation as well, for the measurement of margins. */
typedef struct {
    real dt; /* s since the last tick; more than a period if ticks were missed */
    const VehicleState *state;
    const Target *target;
    const real *signals; /* [SIGNAL_COUNT], at the present */
    const ChannelMeasurement *position;
    const ChannelMeasurement *attitude;
    bool saturated;      /* whether the motors could not deliver the last command */
    bool adapt;          /* false on the ground and while an input is too old to learn from: change no adaptive state */
    real coming_now[3];  /* angular acceleration by the actuators, rad/s^2, body FRD */
    real coming_next[3]; /* the same in one tick, under the command that is already sent */
    bool level_only;     /* true without a velocity estimate: hold level, sink slowly, do not control position */
    bool busy;           /* the caller has no time for what can wait */
    int32_t missed;      /* ticks missed since the last one; the last command was held meanwhile */
    real thrust_n;       /* N, collective thrust delivered now */
    real thrust_scale;   /* thrust of the motors as a multiple of the nominal one */
} ControlInputs;

/* What one channel did in a tick, for the log; zeros where a controller has no such quantity. */
typedef struct {
    real error[6];        /* e = x_rm - x; m, m/s or rad, rad/s */
    real demand[3];       /* u: m/s^2 or rad/s^2 */
    real adaptive[3];     /* nu_ad as commanded (evaluated ahead) */
    real adaptive_now[3]; /* nu_ad of the present state, W'Phi(x) */
    real residual[3];     /* Delta_hat */
    real room[3];         /* bound of |nu_ad| for each axis; zero where there is none */
    real weight_norm;
    real eps_1;
    real eps_2;
    real eps_3;
    real tracking_bound; /* live bound on the tracking error, m or rad; 0 without one */
} ChannelTelemetry;

/* The command: collective thrust and body torque. */
typedef struct {
    real thrust_n;
    real torque_nm[3];
    ChannelTelemetry position;
    ChannelTelemetry attitude;
    real commanded_quaternion[4];
    int32_t law; /* which law flies: 0 the controller's own, 1 the bias alone, 2 none */
} ControlOutput;

#endif
