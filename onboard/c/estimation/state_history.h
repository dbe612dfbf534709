/* Past states of the filter, for measurements that arrive late: the twin of onboard/estimation/state_history.py, which
 * explains it. Sums of corrections are doubles in both number types: one of them grows with time. */
#ifndef DMRAC_STATE_HISTORY_H
#define DMRAC_STATE_HISTORY_H

#include <stdbool.h>
#include <stdint.h>

#include "generated/constants.h"

/* The nominal state at one time. */
typedef struct {
    int64_t time_ns;
    real position[3];
    real velocity[3];
    real rotation[9];
    real rate_world[3];
} PastState;

/* Running sums of all corrections. */
typedef struct {
    double dp[3];
    double dv[3];
    double dvt[3]; /* of dv t */
    double phi[3];
} CorrectionSums;

/* A state, and the sums up to then. */
typedef struct {
    bool used;
    PastState state;
    CorrectionSums sums;
} StoredState;

/* A ring of past states, and the sums of all corrections. */
typedef struct {
    StoredState states[HISTORY_LENGTH];
    int32_t newest;
    double time_s;
    CorrectionSums sums;
} StateHistory;

void history_init(StateHistory *self);

/* Store the state of a new IMU sample. */
void history_append(StateHistory *self, const PastState *state);

/* Apply a correction of the present state to all stored states. */
void history_correct(StateHistory *self, const real dp[3], const real dv[3], const real phi[3]);

/* The state at `time_ns` with all later corrections; false if the history does not reach it. */
bool history_at(const StateHistory *self, int64_t time_ns, PastState *out);

/* Remove all states: after a rotation too large for sums of small rotations. */
void history_clear(StateHistory *self);

#endif
