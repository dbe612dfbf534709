/* An error-state Kalman filter for position, velocity, attitude and the two biases of an IMU. The twin of
 * onboard/estimation/error_state_filter.py, which explains it.
 *
 *     error = (dp, dv, phi, db_g, db_a), each 3 long; phi in the world frame
 *     dp' = dp + dv dt          dv' = dv - [f]x phi dt - R db_a dt          phi' = phi - R db_g dt */
#ifndef DMRAC_ERROR_STATE_FILTER_H
#define DMRAC_ERROR_STATE_FILTER_H

#include "estimation/state_history.h"

/* Standard deviations of accelerometer [m/s^2] and gyroscope [rad/s] samples, and the densities of the biases' random
 * walks [rad/s and m/s^2 per sqrt(s)]. */
typedef struct {
    real accelerometer;
    real gyroscope;
    real gyro_walk;
    real accelerometer_walk;
} ImuNoise;

typedef struct {
    int32_t every; /* IMU samples per covariance step */
    real position[3];
    real velocity[3];
    real quaternion[4];
    real rotation[9];
    real gyro_bias[3];
    real accelerometer_bias[3];
    real P[ERROR_SIZE * ERROR_SIZE];
    int32_t collected;
    real collected_s;
    real collected_dv[3];
    bool has_last_rate;
    real last_rate[3];
    StateHistory history;
} ErrorStateFilter;

void filter_init(ErrorStateFilter *self, int32_t covariance_every);

/* Set the attitude and gyro bias at rest in the origin. `sigmas`: standard deviations of the 15 errors. */
void filter_start(ErrorStateFilter *self, const real quaternion[4], const real gyro_bias[3],
                  const real sigmas[ERROR_SIZE]);

/* Integrate one IMU sample. The accelerometer gives the mean over the step; the gyroscope a rate that is `gyro_delay_s`
 * old. */
void filter_predict(ErrorStateFilter *self, int64_t time_ns, real dt, const real accelerometer[3],
                    const real gyroscope[3], const ImuNoise *noise, real gyro_delay_s);

/* The state at `time_ns` with all later corrections; false if the history does not reach it. */
bool filter_at(const ErrorStateFilter *self, int64_t time_ns, PastState *out);

/* One scalar measurement of the error: h . error = innovation + noise. Returns the score: the squared innovation over its
 * variance. The state changes only if it is within `gate`. */
real filter_correct_scalar(ErrorStateFilter *self, const real h[ERROR_SIZE], real innovation, real variance, real gate);

/* The same for error[index] = innovation + noise. */
real filter_correct_component(ErrorStateFilter *self, int32_t index, real innovation, real variance, real gate);

/* A position measured tau = `delay_s` ago: H = [I, -tau I, 0, 0, 0]. Returns the score. */
real filter_correct_position(ErrorStateFilter *self, const real innovation[3], real delay_s, real variance, real gate);

/* A measured attitude: H = [0, 0, I, 0, 0]. Returns the score. */
real filter_correct_attitude(ErrorStateFilter *self, const real innovation[3], real variance, real gate);

/* An attitude measured tau = `delay_s` ago: H = [0, 0, I, tau R, 0]. Returns the score. */
real filter_correct_past_attitude(ErrorStateFilter *self, const real innovation[3], real delay_s, real variance,
                                  real gate);

/* Correct position, velocity and attitude, now and in the history: p + dp, v + dv, exp(phi) q. */
void filter_shift(ErrorStateFilter *self, const real dp[3], const real dv[3], const real phi[3]);

/* Remove the stored states: after a rotation too large for sums of small rotations. */
void filter_forget_history(ErrorStateFilter *self);

/* Make three errors from `start` on uncorrelated with all others, with standard deviation `sigma`. */
void filter_restart_error(ErrorStateFilter *self, int32_t start, real sigma);

/* Add an uncertainty of `sigma` to `size` errors from `start` on. */
void filter_inflate(ErrorStateFilter *self, int32_t start, real sigma, int32_t size);

/* Add an uncertainty of `sigma` to the velocity, of an error that has lasted for `seconds`. */
void filter_inflate_motion(ErrorStateFilter *self, real sigma, real seconds);

#endif
