#include "control/laws/slope_bound.h"

#include <string.h>

#include "control/features_q15.h"
#include "numerics/elementary.h"
#include "numerics/small_matrix.h"

/* Of the share of its limit: below 1 by more than whole numbers are wrong. */
#define FLAT_SQUARE REAL(0.98)

/* The place of a signal among the inputs; -1 if the features do not see it. */
static int32_t place_of(const FeatureSelection *selection, int32_t signal) {
    for (int32_t i = 0; i < selection->count; i++) {
        if (selection->index[i] == signal) {
            return i;
        }
    }
    return -1;
}

/* SlopeBound.__init__ */
void slope_bound_init(SlopeBound *self, const FeatureSelection *selection, const SlopeLimits *limits) {
    const real *limit[SLOPE_INPUTS_MAX];
    memset(self, 0, sizeof *self);
    for (int group = 0; group < limits->groups; group++) {
        for (int i = 0; i < 3; i++) {
            int32_t place = place_of(selection, limits->first[group] + i);
            if (place >= 0) {
                limit[self->count] = limits->limit + 3 * group;
                self->inputs[self->count++] = place;
            }
        }
    }
    for (int axis = 0; axis < 3; axis++) {
        for (int j = 0; j < self->count; j++) {
            self->units[axis * self->count + j] = REAL(1.0) / limit[j][axis];
        }
    }
}

#ifdef DMRAC_Q15_FEATURES
/* Whether the slope of every axis is within its limit, in whole numbers: then J is not needed. */
static bool is_flat(const SlopeBound *self, const Features *features, const real *z, const real *theta,
                    const KalmanState *state) {
    real W[FEATURES_MAX * 3], slope[3 * SLOPE_INPUTS_MAX];
    for (int i = 0; i < 3 * (features->feature_count - 1); i++) {
        W[i] = theta[i] + state->X[i];
    }
    q15_map_slope(features, W, z, self->inputs, self->count, slope);
    for (int axis = 0; axis < 3; axis++) {
        real square = REAL(0.0);
        for (int j = 0; j < self->count; j++) {
            real share = slope[axis * self->count + j] * self->units[axis * self->count + j];
            square += share * share;
        }
        if (!(square <= FLAT_SQUARE)) {
            return false;
        }
    }
    return true;
}
#endif

/* SlopeBound.step */
void slope_bound_step(SlopeBound *self, const Features *features, const real signals[SIGNAL_COUNT], const real *theta,
                      KalmanState *state) {
    if (self->ticks == 0 && self->count > 0) {
        real z[INPUTS_MAX];
        features_select(features, signals, z);
#ifdef DMRAC_Q15_FEATURES
        if (features->q15 && is_flat(self, features, z, theta, state)) {
            self->ticks = 1;
            return;
        }
#endif
        features_slope(features, z, self->inputs, self->count, self->work.J, self->work.along);
        bound_slopes(state, theta, self->units, self->count, &self->work);
    }
    self->ticks = (self->ticks + 1) % SLOPE_PERIOD_TICKS;
}

/* slopes [3, n] = (theta + X)'J units; of which axes their norm is above 1. Returns whether there is one. */
static bool slopes_of(const KalmanState *state, const real *theta, const real *J, const real *units, int32_t n,
                      real *slopes, bool steep[3]) {
    real W[FEATURES_MAX * 3];
    Factor weights[3], column;
    int32_t rows = state->size - 2; /* without the constant and the bias */
    bool any = false;
    for (int i = 0; i < 3 * rows; i++) {
        W[i] = theta[i] + state->X[i];
    }
    factors_take(weights, W, rows);
    for (int j = 0; j < n; j++) {
        factor_take(&column, J + j, rows, n);
        for (int axis = 0; axis < 3; axis++) {
            slopes[axis * n + j] = factor_dot(weights + axis, &column, rows) * units[axis * n + j];
        }
    }
    for (int axis = 0; axis < 3; axis++) {
        steep[axis] = dot(slopes + axis * n, slopes + axis * n, n) > REAL(1.0);
        any = any || steep[axis];
    }
    return any;
}

/* S J and J'S J. */
static void look_along(const KalmanState *state, int32_t n, SlopeWorkspace *work) {
    int size = state->size, rows = size - 2;
    for (int j = 0; j < n; j++) {
        real column[STATES_MAX], g[STATES_MAX], most = REAL(1.0);
        for (int m = 0; m < rows; m++) {
            column[m] = work->J[m * n + j];
            most = real_max(most, real_abs(column[m]));
        }
        kalman_state_product(state, column, rows, most, g);
        for (int i = 0; i < size; i++) {
            work->along[i * n + j] = g[i];
        }
    }
    for (int j = 0; j < n; j++) {
        Factor along, column;
        factor_take(&along, work->along + j, rows, n);
        for (int i = j; i < n; i++) {
            factor_take(&column, work->J + i, rows, n);
            work->among[i * n + j] = work->among[j * n + i] = factor_dot(&column, &along, rows);
        }
    }
}

/* X -= mu S A'y of one axis; unit, slope [n]. */
static void flatten(KalmanState *state, int axis, const real *unit, const real *slope, int32_t n,
                    SlopeWorkspace *work) {
    real y[SLOPE_INPUTS_MAX];
    for (int i = 0; i < n; i++) {
        for (int j = 0; j < n; j++) {
            work->scaled[i * n + j] = unit[i] * work->among[i * n + j] * unit[j];
        }
    }
    real mu = multiplier(work->scaled, slope, n, 1, REAL(1.0), y, work->factor);
    for (int j = 0; j < n; j++) {
        y[j] *= unit[j];
    }
    for (int i = 0; i < state->size; i++) {
        state->X[3 * i + axis] -= mu * dot(work->along + i * n, y, n);
    }
}

/* bound_slopes */
void bound_slopes(KalmanState *state, const real *theta, const real *units, int32_t n, SlopeWorkspace *work) {
    real slopes[3 * SLOPE_INPUTS_MAX];
    bool steep[3];
    if (!slopes_of(state, theta, work->J, units, n, slopes, steep)) {
        return;
    }
    look_along(state, n, work);
    for (int axis = 0; axis < 3; axis++) {
        if (steep[axis]) {
            flatten(state, axis, units + axis * n, slopes + axis * n, n, work);
        }
    }
}
