#include "estimation/pose_trust.h"

#include <string.h>

#include "generated/constants.h"
#include "numerics/elementary.h"
#include "numerics/whole.h"
#include "protocol/geometry.h"

/* PoseTrust.__init__ */
void pose_trust_init(PoseTrust *self, const EstimatorConfig *config) {
    memset(self, 0, sizeof *self);
    self->config = *config;
    self->fresh_ns = nanoseconds_below(config->aid_fresh_s);
    self->flow_ns = self->range_ns = self->pressure_ns = NEVER_NS;
}

/* Seconds since `then_ns` for which a residual counts. */
static real since(int64_t then_ns, int64_t now_ns) {
    return real_min(real_max((real)(now_ns - then_ns) * REAL(1e-9), REAL(0.0)), STEP_MAX_S);
}

static real across(real north, real east) {
    return real_sqrt(north * north + east * east);
}

/* PoseTrust._lost_m: what the position may have lost in `age_s` without poses */
static real lost_m(const PoseTrust *self, real age_s, int64_t now_ns) {
    bool seen = now_ns - self->flow_ns < self->fresh_ns;
    return age_s * (seen ? self->config.pose_jump_rate_m_s : self->config.pose_blind_rate_m_s);
}

/* PoseTrust.implausible */
bool pose_trust_implausible(const PoseTrust *self, const real innovation[3], const real turn[3], const real rate[3],
                            real age_s, int64_t now_ns) {
    const EstimatorConfig *config = &self->config;
    real far_m = lost_m(self, age_s, now_ns) + (self->drifting ? REAL(0.0) : config->pose_jump_m);
    real turned =
        config->pose_turn_max_rad + TURN_RATE_RAD_S * age_s + config->pose_time_error_max_s * vector_length(rate);
    return !self->blind && (vector_length(innovation) > far_m || vector_length(turn) > turned);
}

/* PoseTrust.note_jump: what is more than the position may have lost moves it away from the flow */
void pose_trust_note_jump(PoseTrust *self, const real step[3], real age_s, int64_t now_ns) {
    real across_m = across(step[0], step[1]);
    real more_m = across_m - lost_m(self, age_s, now_ns);
    if (more_m > REAL(0.0)) {
        self->north_m -= step[0] * more_m / across_m;
        self->east_m -= step[1] * more_m / across_m;
    }
}

/* PoseTrust.note_flow */
void pose_trust_note_flow(PoseTrust *self, const real innovation[2], const real rotation[9], int64_t now_ns) {
    real dt = since(self->flow_ns, now_ns);
    self->flow_ns = now_ns;
    real north = rotation[0] * innovation[0] + rotation[1] * innovation[1];
    real east = rotation[3] * innovation[0] + rotation[4] * innovation[1];
    real keep = real_exp(-dt / self->config.pose_drift_average_s);
    self->north_m = keep * self->north_m + dt * north;
    self->east_m = keep * self->east_m + dt * east;
    real share = REAL(1.0) - real_exp(-dt / SLOW_S);
    self->north_m_s += share * (north - self->north_m_s);
    self->east_m_s += share * (east - self->east_m_s);
}

/* _step: from an average to a new value, within RANGE_STEP_MAX_M */
static real step_to(real average_m, real new_m) {
    return real_min(real_max(new_m - average_m, -RANGE_STEP_MAX_M), RANGE_STEP_MAX_M);
}

/* PoseTrust.note_range */
void pose_trust_note_range(PoseTrust *self, real down_m, real innovation_m, int64_t now_ns) {
    if (now_ns - self->range_ns > self->fresh_ns) {
        self->slow_m = self->fast_m = down_m;
    }
    real dt = since(self->range_ns, now_ns);
    self->range_ns = now_ns;
    real fast = REAL(1.0) - real_exp(-dt / FAST_S), slow = REAL(1.0) - real_exp(-dt / SLOW_S);
    self->range_m += fast * step_to(self->range_m, innovation_m);
    down_m = self->slow_m + step_to(self->slow_m, down_m);
    self->slow_m += slow * (down_m - self->slow_m);
    self->fast_m += fast * (down_m - self->fast_m);
}

/* PoseTrust.note_pressure */
void pose_trust_note_pressure(PoseTrust *self, real innovation_m, int64_t now_ns) {
    real dt = since(self->pressure_ns, now_ns);
    self->pressure_ns = now_ns;
    self->pressure_m += (REAL(1.0) - real_exp(-dt / SLOW_S)) * (innovation_m - self->pressure_m);
}

/* PoseTrust.forget */
void pose_trust_forget(PoseTrust *self) {
    self->north_m = self->east_m = self->north_m_s = self->east_m_s = REAL(0.0);
    self->range_m = self->pressure_m = REAL(0.0);
}

/* PoseTrust.drift */
bool pose_trust_drift(PoseTrust *self, const real position[3], const real velocity[3], int64_t now_ns, real moved_m[3],
                      real moved_m_s[3]) {
    real limit_m = self->config.pose_drift_m;
    bool known = now_ns - self->range_ns < self->fresh_ns;
    bool both = known && now_ns - self->pressure_ns < self->fresh_ns;
    real confirmed_m = self->range_m < REAL(0.0) ? -self->pressure_m : self->pressure_m;
    bool along = both && confirmed_m > PRESSURE_SHARE * limit_m && real_abs(self->range_m) > limit_m;
    if (across(self->north_m, self->east_m) <= limit_m && !along) {
        return false;
    }
    real climb_m_s = (self->fast_m - self->slow_m) / (SLOW_S - FAST_S);
    real down_m = self->fast_m + FAST_S * climb_m_s;
    moved_m[0] = self->north_m;
    moved_m[1] = self->east_m;
    moved_m[2] = known ? down_m - position[2] : REAL(0.0);
    moved_m_s[0] = self->north_m_s;
    moved_m_s[1] = self->east_m_s;
    moved_m_s[2] = known ? climb_m_s - velocity[2] : REAL(0.0);
    pose_trust_forget(self);
    self->drifting = true;
    return true;
}
