#include "control/version_test.h"

#include <string.h>

#include "numerics/elementary.h"
#include "protocol/geometry.h"

/* Rows of the corners. */
enum { PLACE_ROW = 0, VELOCITY_ROW = 3, ANGLE_ROW = 6, BODY_VELOCITY_ROW = 9, MOTOR_ROW = 12 };

/* How far the box reaches in the angles, rad. */
#define ANGLE_REACH_RAD REAL(0.2)

/* VersionTest.__init__ */
void version_test_init(VersionTest *self, const VersionTestConfig *config, int32_t channel, const SlopeLimits *limits) {
    memset(self, 0, sizeof *self);
    self->config = *config;
    self->channel = channel;
    self->slope_limits = *limits;
    for (int axis = 0; axis < BOX_AXES; axis++) {
        for (int point = 0; point < BOX_POINTS; point++) {
            self->corners[axis * BOX_POINTS + point] = REAL(2.0) * halton(point + 1, axis) - REAL(1.0);
        }
    }
}

/* The states on the line ahead. */
static void path_ahead(VersionTest *self, const real now[SIGNAL_COUNT]) {
    const real *velocity = now + SIGNAL_VELOCITY_N;
    real speed = vector_length(velocity), forward[3] = {REAL(1.0), REAL(0.0), REAL(0.0)};
    if (speed > REAL(0.0)) {
        for (int i = 0; i < 3; i++) {
            forward[i] = velocity[i] / speed;
        }
    }
    real length = real_max(speed * self->config.reach_s, STEP_MIN_M * (real)(PATH_POINTS - 1));
    for (int point = 0; point < PATH_POINTS; point++) {
        real *state = self->path + point * SIGNAL_COUNT;
        memcpy(state, now, SIGNAL_COUNT * sizeof(real));
        for (int i = 0; i < 3; i++) {
            state[SIGNAL_POSITION_N + i] += forward[i] * ((real)point * (length / (real)(PATH_POINTS - 1)));
        }
    }
}

/* ahead: the states on the line ahead and in the box */
static void see_ahead(VersionTest *self, const real now[SIGNAL_COUNT]) {
    static const int motor_rows[4] = {MOTOR_ROW, MOTOR_ROW + 1, MOTOR_ROW + 2, MOTOR_ROW};
    const real *velocity = now + SIGNAL_VELOCITY_N;
    real h = self->config.reach_s, turn = self->config.acceleration_m_s2 * h;
    path_ahead(self, now);
    for (int point = 0; point < BOX_POINTS; point++) {
        real *state = self->box + point * SIGNAL_COUNT;
        const real *corner = self->corners + point; /* of the first axis; the others follow */
        memcpy(state, now, SIGNAL_COUNT * sizeof(real));
        for (int i = 0; i < 3; i++) {
            real reach = REAL(0.5) * h * (real_abs(velocity[i]) + turn);
            state[SIGNAL_POSITION_N + i] += REAL(0.5) * h * velocity[i] + reach * corner[(PLACE_ROW + i) * BOX_POINTS];
            state[SIGNAL_VELOCITY_N + i] += turn * corner[(VELOCITY_ROW + i) * BOX_POINTS];
            state[SIGNAL_ROLL + i] += ANGLE_REACH_RAD * corner[(ANGLE_ROW + i) * BOX_POINTS];
            state[SIGNAL_BODY_VELOCITY_X + i] += turn * corner[(BODY_VELOCITY_ROW + i) * BOX_POINTS];
        }
        for (int motor = 0; motor < 4; motor++) {
            real share = REAL(0.5) * corner[motor_rows[motor] * BOX_POINTS];
            state[SIGNAL_MOTOR_THRUST_1 + motor] *= REAL(1.0) + share;
        }
    }
}

/* theta'Phi at a signal vector. */
static void map_at(const Features *features, const real *theta, const real signals[SIGNAL_COUNT], real nu[3]) {
    real z[INPUTS_MAX], Phi[FEATURES_MAX];
    features_select(features, signals, z);
    features_evaluate(features, z, Phi);
    vector_zero(nu);
    for (int i = 0; i < features->feature_count; i++) {
        for (int axis = 0; axis < 3; axis++) {
            nu[axis] += theta[3 * i + axis] * Phi[i];
        }
    }
}

/* The largest change of the map from `here` to n states, or `spread` if that is larger. */
static real spread_over(const Features *features, const real *theta, const real here[3], const real *states, int32_t n,
                        real spread) {
    for (int32_t i = 0; i < n; i++) {
        real nu[3];
        map_at(features, theta, states + i * SIGNAL_COUNT, nu);
        for (int axis = 0; axis < 3; axis++) {
            spread = real_largest(spread, real_abs(nu[axis] - here[axis]));
        }
    }
    return spread;
}

/* VersionTest._reach: the largest change from here, and the largest slope along the path as a share of its limit */
static void reach(VersionTest *self, const Features *features, const real *theta, const real *recent, int32_t n) {
    real here[3], before[3], step[3], steps[3] = {REAL(0.0), REAL(0.0), REAL(0.0)};
    vector_subtract(self->path + SIGNAL_COUNT + SIGNAL_POSITION_N, self->path + SIGNAL_POSITION_N, step);
    real apart = vector_length(step);
    map_at(features, theta, self->path, here);
    vector_copy(here, before);
    for (int point = 1; point < PATH_POINTS; point++) {
        real nu[3];
        map_at(features, theta, self->path + point * SIGNAL_COUNT, nu);
        for (int axis = 0; axis < 3; axis++) {
            steps[axis] = real_largest(steps[axis], real_abs(nu[axis] - before[axis]));
        }
        vector_copy(nu, before);
    }
    real spread = spread_over(features, theta, here, self->path, PATH_POINTS, REAL(0.0));
    spread = spread_over(features, theta, here, recent, n, spread);
    self->found.spread = spread_over(features, theta, here, self->box, BOX_POINTS, spread);
    const real *place_limit = slope_limits_at(&self->slope_limits, SIGNAL_POSITION_N);
    self->found.along = REAL(0.0);
    for (int axis = 0; axis < 3; axis++) {
        self->found.along = real_largest(self->found.along, steps[axis] / apart / place_limit[axis]);
    }
}

/* The largest slope over all states, as a share of its limit. */
static real slope_over(VersionTest *self, const Features *features, const real *theta, const real *recent, int32_t n) {
    const real *states[3] = {self->path, self->box, recent};
    const int32_t counts[3] = {PATH_POINTS, BOX_POINTS, n};
    real largest = REAL(0.0);
    for (int i = 0; features->kind == ADAPTIVE_FEATURES_NETWORK && i < 3; i++) {
        real shares[3];
        largest_shares(features, theta, &self->slope_limits, states[i], counts[i], shares);
        largest = real_largest(real_largest(real_largest(largest, shares[0]), shares[1]), shares[2]);
    }
    return largest;
}

/* VersionTest._misfit: misfit over the last second, as a share of what is allowed */
static real misfit(const VersionTest *self, const Features *features, const real *theta, const real *recent,
                   const real *residuals, int32_t n) {
    real of_map = REAL(0.0), of_none = REAL(0.0);
    if (n == 0) {
        return REAL(0.0);
    }
    for (int32_t i = 0; i < n; i++) {
        real nu[3];
        map_at(features, theta, recent + i * SIGNAL_COUNT, nu);
        vector_subtract(nu, residuals + 3 * i, nu);
        of_map += vector_squared_length(nu);
        of_none += vector_squared_length(residuals + 3 * i);
    }
    real size = real_sqrt(of_none / (real)n);
    return real_sqrt(of_map / (real)n) / (self->config.misfit * size + self->config.misfit_floor[self->channel]);
}

/* norm(theta) norm(Phi), row of the constant apart */
static real bound_of(const real *theta, int32_t k) {
    real largest = REAL(0.0);
    for (int axis = 0; axis < 3; axis++) {
        real squares = REAL(0.0);
        for (int i = 0; i < k - 1; i++) {
            squares += theta[3 * i + axis] * theta[3 * i + axis];
        }
        largest = real_largest(largest, real_sqrt(squares));
    }
    return largest * real_sqrt((real)(k - 1));
}

/* VersionTest.refusal */
Refusal version_test_refusal(VersionTest *self, const Features *features, const real *theta,
                             const real now[SIGNAL_COUNT], const real *recent, const real *residuals, int32_t n) {
    const VersionTestConfig *config = &self->config;
    VersionFindings *found = &self->found;
    int32_t channel = self->channel;
    see_ahead(self, now);
    reach(self, features, theta, recent, n);
    found->bound = bound_of(theta, features->feature_count);
    found->over = slope_over(self, features, theta, recent, n);
    found->misfit = misfit(self, features, theta, recent, residuals, n);
    if (found->misfit > REAL(1.0)) {
        return REFUSAL_MISFIT;
    }
    if (found->bound > config->bound_max[channel] || found->spread > config->spread_max[channel]) {
        return REFUSAL_REACH;
    }
    bool steep = found->along > config->path_slope[channel] || found->over > config->box_slope[channel];
    return steep ? REFUSAL_SLOPE : REFUSAL_NONE;
}

/* VersionTest.still_good */
bool version_test_still_good(VersionTest *self, const Features *features, const real *theta,
                             const real now[SIGNAL_COUNT]) {
    see_ahead(self, now);
    self->found = (VersionFindings){REAL(0.0), REAL(0.0), REAL(0.0), REAL(0.0), REAL(0.0)};
    reach(self, features, theta, NULL, 0);
    return self->found.spread <= self->config.spread_max[self->channel] &&
           self->found.along <= self->config.path_slope[self->channel];
}
