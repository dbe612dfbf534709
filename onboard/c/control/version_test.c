#include "control/version_test.h"

#include <string.h>

#include "control/laws/products.h"
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

/* A state on the line ahead. */
static void state_on_path(const VersionTestConfig *config, const real now[SIGNAL_COUNT], int32_t point, real *state) {
    const real *velocity = now + SIGNAL_VELOCITY_N;
    real speed = vector_length(velocity), forward[3] = {REAL(1.0), REAL(0.0), REAL(0.0)};
    if (speed > REAL(0.0)) {
        for (int i = 0; i < 3; i++) {
            forward[i] = velocity[i] / speed;
        }
    }
    real length = real_max(speed * config->reach_s, STEP_MIN_M * (real)(PATH_POINTS - 1));
    memcpy(state, now, SIGNAL_COUNT * sizeof(real));
    for (int i = 0; i < 3; i++) {
        state[SIGNAL_POSITION_N + i] += forward[i] * ((real)point * (length / (real)(PATH_POINTS - 1)));
    }
}

/* A state of the box; corner: the numbers of the first axis, those of the others follow */
static void box_state(const VersionTestConfig *config, const real now[SIGNAL_COUNT], const real *corner, real *state) {
    static const int motor_rows[4] = {MOTOR_ROW, MOTOR_ROW + 1, MOTOR_ROW + 2, MOTOR_ROW};
    const real *velocity = now + SIGNAL_VELOCITY_N;
    real h = config->reach_s, turn = config->acceleration_m_s2 * h;
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

void ahead_state(const Ahead *self, const VersionTest *test, int32_t index, real state[SIGNAL_COUNT]) {
    if (index < PATH_POINTS) {
        state_on_path(&test->config, self->now, index, state);
    } else {
        box_state(&test->config, self->now, test->corners + index - PATH_POINTS, state);
    }
}

/* Ahead.begin */
void ahead_begin(Ahead *self, const VersionTest *test, const real now[SIGNAL_COUNT]) {
    real next[SIGNAL_COUNT], step[3];
    memcpy(self->now, now, sizeof self->now);
    ahead_state(self, test, 1, next);
    vector_subtract(next + SIGNAL_POSITION_N, now + SIGNAL_POSITION_N, step);
    self->apart = vector_length(step);
    self->seen = 0;
    self->steps[0] = self->steps[1] = self->steps[2] = REAL(0.0);
}

/* Ahead.begin_slopes */
void ahead_begin_slopes(Ahead *self, const VersionTest *test, const real now[SIGNAL_COUNT]) {
    ahead_begin(self, test, now);
    self->sloped = 0;
    self->over = REAL(0.0);
}

static real largest_of(const real three[3]) {
    return real_largest(real_largest(three[0], three[1]), three[2]);
}

/* Ahead.steepest */
bool ahead_steepest(Ahead *self, const VersionTest *test, const Features *features, const real *theta, int32_t most) {
    for (int32_t i = 0; i < most && self->sloped < BOX_POINTS; i++, self->sloped++) {
        real state[SIGNAL_COUNT], shares[3];
        ahead_state(self, test, PATH_POINTS + self->sloped, state);
        if (features->kind == ADAPTIVE_FEATURES_NETWORK) {
            largest_shares(features, theta, &test->slope_limits, state, 1, shares);
            self->over = real_largest(self->over, largest_of(shares));
        }
    }
    return self->sloped == BOX_POINTS;
}

/* What `found` needs of nu at the next state. */
static void note_nu(Ahead *self, const real nu[3]) {
    for (int axis = 0; axis < 3; axis++) {
        real step = REAL(0.0);
        if (self->seen == 0) {
            self->here[axis] = self->low[axis] = self->high[axis] = nu[axis];
        } else if (self->seen < PATH_POINTS) {
            step = real_abs(nu[axis] - self->last[axis]);
        }
        self->high[axis] = real_largest(self->high[axis], nu[axis]);
        self->low[axis] = -real_largest(-self->low[axis], -nu[axis]);
        self->steps[axis] = real_largest(self->steps[axis], step);
        self->last[axis] = nu[axis];
    }
}

/* Ahead.step */
bool ahead_step(Ahead *self, const VersionTest *test, const Features *features, const real *theta, int32_t most) {
    real states[AHEAD_PER_PART * SIGNAL_COUNT], Phi[AHEAD_PER_PART * FEATURES_MAX], nu[3];
    while (most > 0 && self->seen < PATH_POINTS + BOX_POINTS) {
        int32_t left = PATH_POINTS + BOX_POINTS - self->seen, n = most < left ? most : left;
        n = n < AHEAD_PER_PART ? n : AHEAD_PER_PART;
        for (int32_t i = 0; i < n; i++) {
            ahead_state(self, test, self->seen + i, states + i * SIGNAL_COUNT);
        }
        features_at(features, states, n, Phi, FEATURES_MAX);
        for (int32_t i = 0; i < n; i++, self->seen++) {
            weighted(theta, Phi + i * FEATURES_MAX, features->feature_count, nu);
            note_nu(self, nu);
        }
        most -= n;
    }
    return self->seen == PATH_POINTS + BOX_POINTS;
}

/* The largest change of the map from here to nu. */
static real change_to(const Ahead *self, const real nu[3]) {
    real change[3];
    for (int axis = 0; axis < 3; axis++) {
        change[axis] = real_abs(nu[axis] - self->here[axis]);
    }
    return largest_of(change);
}

/* Ahead.found, but for `over` */
static void find(const Ahead *self, const SlopeLimits *limits, real *spread, real *along) {
    const real *place_limit = slope_limits_at(limits, SIGNAL_POSITION_N);
    *spread = real_largest(change_to(self, self->low), change_to(self, self->high));
    *along = REAL(0.0);
    for (int axis = 0; axis < 3; axis++) {
        *along = real_largest(*along, self->steps[axis] / self->apart / place_limit[axis]);
    }
}

/* --- the verdict --- */

void recent_map_add(RecentMap *self, const real nu[3], const real residual[3]) {
    real off[3];
    for (int axis = 0; axis < 3; axis++) {
        self->high[axis] = self->count > 0 ? real_largest(self->high[axis], nu[axis]) : nu[axis];
        self->low[axis] = self->count > 0 ? -real_largest(-self->low[axis], -nu[axis]) : nu[axis];
    }
    vector_subtract(nu, residual, off);
    self->misfit += vector_squared_length(off);
    self->size += vector_squared_length(residual);
    self->count++;
}

/* VersionTest._misfit: misfit over the last second, as a share of what is allowed */
static real misfit(const VersionTest *self, const RecentMap *recent) {
    if (recent->count == 0) {
        return REAL(0.0);
    }
    real n = (real)recent->count, size = real_sqrt(recent->size / n);
    return real_sqrt(recent->misfit / n) / (self->config.misfit * size + self->config.misfit_floor[self->channel]);
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

/* VersionTest.verdict */
Refusal version_test_verdict(VersionTest *self, const real *theta, int32_t k, const RecentMap *recent, real over) {
    const VersionTestConfig *config = &self->config;
    VersionFindings *found = &self->found;
    int32_t channel = self->channel;
    find(&self->ahead, &self->slope_limits, &found->spread, &found->along);
    if (recent->count > 0) {
        real changes[2] = {change_to(&self->ahead, recent->low), change_to(&self->ahead, recent->high)};
        found->spread = real_largest(found->spread, real_largest(changes[0], changes[1]));
    }
    found->bound = bound_of(theta, k);
    found->over = real_largest(over, self->ahead.over);
    found->misfit = misfit(self, recent);
    if (found->misfit > REAL(1.0)) {
        return REFUSAL_MISFIT;
    }
    if (found->bound > config->bound_max[channel] || found->spread > config->spread_max[channel]) {
        return REFUSAL_REACH;
    }
    bool steep = found->along > config->path_slope[channel] || found->over > config->box_slope[channel];
    return steep ? REFUSAL_SLOPE : REFUSAL_NONE;
}

/* VersionTest.refusal */
Refusal version_test_refusal(VersionTest *self, const Features *features, const real *theta,
                             const real now[SIGNAL_COUNT], const real *recent, const real *residuals, int32_t n) {
    int32_t k = features->feature_count;
    real Phi[FEATURES_MAX], shares[3] = {REAL(0.0), REAL(0.0), REAL(0.0)};
    RecentMap map;
    memset(&map, 0, sizeof map);
    ahead_begin_slopes(&self->ahead, self, now);
    ahead_steepest(&self->ahead, self, features, theta, BOX_POINTS);
    ahead_step(&self->ahead, self, features, theta, PATH_POINTS + BOX_POINTS);
    if (features->kind == ADAPTIVE_FEATURES_NETWORK) {
        largest_shares(features, theta, &self->slope_limits, recent, n, shares);
    }
    for (int32_t i = 0; i < n; i++) {
        real nu[3];
        features_at(features, recent + i * SIGNAL_COUNT, 1, Phi, 0);
        weighted(theta, Phi, k, nu);
        recent_map_add(&map, nu, residuals + 3 * i);
    }
    return version_test_verdict(self, theta, k, &map, largest_of(shares));
}

/* VersionTest.look */
bool version_test_look(VersionTest *self, const Features *features, const real *theta, const real now[SIGNAL_COUNT]) {
    if (!self->looks) {
        ahead_begin(&self->look, self, now);
    }
    self->looks = !ahead_step(&self->look, self, features, theta, CHECKED_PER_PART);
    if (self->looks) {
        return false;
    }
    self->found = (VersionFindings){REAL(0.0), REAL(0.0), REAL(0.0), REAL(0.0), REAL(0.0)};
    find(&self->look, &self->slope_limits, &self->found.spread, &self->found.along);
    self->good = self->found.spread <= self->config.spread_max[self->channel] &&
                 self->found.along <= self->config.path_slope[self->channel];
    return true;
}
