#include "estimation/pose_fusion.h"

#include <math.h>
#include <string.h>

#include "numerics/elementary.h"
#include "numerics/whole.h"
#include "protocol/geometry.h"

/* PoseFusion.__init__ */
void pose_fusion_init(PoseFusion *self, const EstimatorConfig *config) {
    memset(self, 0, sizeof *self);
    self->config = *config;
    self->delay_max_ns = nanoseconds_below(config->pose_delay_max_s);
    self->last_capture_ns = NEVER_NS;
    pose_trust_init(&self->trust, config);
}

static real square(real x) {
    return x * x;
}

/* PoseFusion._is_implausible: whether a pose in flight is where the vehicle cannot be. The first one may be anywhere. */
static bool is_implausible(const PoseFusion *self, const PoseSurroundings *at, const Pose *pose, const PastState *past,
                           const real innovation[3], int64_t now_ns) {
    real turn[3];
    if (!self->had_pose || !at->corrections->in_flight) {
        return false;
    }
    if (stuck_gyro_any(at->gyro)) {
        vector_zero(turn);
    } else {
        rotation_between(pose->quaternion, past->rotation, turn);
    }
    real age_s = (real)(now_ns - at->state->last_pose_ns) * REAL(1e-9);
    return pose_trust_implausible(&self->trust, innovation, turn, past->rate_world, age_s, now_ns);
}

/* PoseFusion.check_drift */
void pose_fusion_check_drift(PoseFusion *self, const PoseSurroundings *at, int64_t now_ns) {
    const real level[3] = {REAL(0.0), REAL(0.0), REAL(0.0)};
    ErrorStateFilter *filter = at->filter;
    PoseTrust *trust = &self->trust;
    if (!self->had_pose || !at->corrections->in_flight || stuck_gyro_any(at->gyro) || trust->drifting || trust->blind) {
        pose_trust_forget(trust);
        return;
    }
    real before[3], moved_m[3], moved_m_s[3];
    bool fresh = now_ns - at->state->last_pose_ns < trust->fresh_ns;
    if (!fresh || !pose_trust_drift(trust, filter->position, filter->velocity, now_ns, moved_m, moved_m_s)) {
        return;
    }
    vector_copy(filter->position, before);
    filter_shift(filter, moved_m, moved_m_s, level);
    filter_inflate(filter, VELOCITY, DRIFT_VELOCITY_SIGMA, 2);
    if (moved_m[2] != REAL(0.0)) {
        filter_inflate(filter, POSITION + 2, DRIFT_HEIGHT_SIGMA, 1);
        filter_inflate(filter, VELOCITY + 2, DRIFT_CLIMB_SIGMA, 1);
    }
    self->refused_in_a_row = 0;
    self->drifts++;
    estimator_report(&at->corrections->events, now_ns, ESTIMATOR_POSES_DRIFT, 0)->values[0] = vector_length(moved_m);
    corrections_announce_jump(at->corrections, filter, at->state, before, AID_POSE_POSITION, now_ns, REAL(0.0), true);
}

/* _softened: the variance at which an innovation of squared length `off` passes the gate, if it is not larger than
 * `near` */
static real softened(real variance, real off, real near, real gate) {
    return off <= near * near ? real_max(variance, off / gate) : variance;
}

/* PoseFusion._widen_velocity */
static void widen_velocity(const PoseFusion *self, ErrorStateFilter *filter, const real innovation[3], real delay_s) {
    const real *P = filter->P;
    real variance = P[0] + P[ERROR_SIZE + 1] + P[2 * (ERROR_SIZE + 1)];
    real off = vector_squared_length(innovation);
    if (off > REAL(2.0) * (variance + REAL(3.0) * square(self->config.pose_position_sigma_m))) {
        filter_inflate_motion(filter, real_sqrt(off) / WRONG_FOR_S, WRONG_FOR_S + delay_s);
    }
}

/* PoseFusion._attitude_variance: rad^2 per axis: its own noise, and the turn within the error of its time */
static real attitude_variance(const PoseFusion *self, const PastState *past, real time_sigma_s) {
    real sigma_s = real_max(self->config.pose_turn_time_sigma_s, time_sigma_s);
    return square(self->config.pose_attitude_sigma_rad) + square(sigma_s) * vector_squared_length(past->rate_world);
}

/* PoseFusion._explained_by_time: whether a wrong capture time alone may explain the difference of a pose's attitude */
static bool explained_by_time(const PoseFusion *self, const real turn[3], const real rate[3]) {
    real most = self->config.pose_near_rad + self->config.pose_time_error_max_s * vector_length(rate);
    return vector_length(turn) < most;
}

/* PoseFusion._fuse_attitude_of_lost_axis. R_past as if the present bias had been known since then: exp(-turn) R_past */
static void fuse_attitude_of_lost_axis(const PoseFusion *self, const PoseSurroundings *at, const Pose *pose,
                                       const PastState *past, int64_t capture_ns, real time_sigma_s) {
    ErrorStateFilter *filter = at->filter;
    real more[3], turn[3], gate = self->config.pose_gate;
    stuck_gyro_turn_since(at->gyro, capture_ns, filter->gyro_bias, more);
    matrix_times(filter->rotation, more, more);
    rotation_between(pose->quaternion, past->rotation, turn);
    vector_add(turn, more, turn);
    real variance = attitude_variance(self, past, time_sigma_s);
    real delay_s = (real)(at->state->last_imu_ns - capture_ns) * REAL(1e-9);
    if (filter_correct_past_attitude(filter, turn, delay_s, variance, gate) > gate) {
        real soft = softened(variance, vector_squared_length(turn), REAL(HUGE_VAL), gate);
        filter_correct_past_attitude(filter, turn, delay_s, soft, REAL(HUGE_VAL));
    }
}

/* The attitude of a pose whose position was used; false if the whole pose counts as refused. */
static bool fuse_attitude(PoseFusion *self, const PoseSurroundings *at, const Pose *pose, const PastState *past,
                          real time_sigma_s) {
    const EstimatorConfig *config = &self->config;
    real turn[3];
    rotation_between(pose->quaternion, past->rotation, turn);
    real variance = attitude_variance(self, past, time_sigma_s);
    variance = softened(variance, vector_squared_length(turn), config->pose_near_rad, config->pose_gate);
    real score = filter_correct_attitude(at->filter, turn, variance, config->pose_gate);
    corrections_note_score(at->corrections, AID_POSE_ATTITUDE, score, config->pose_gate, 3);
    if (score > config->pose_gate) {
        self->attitude_refused++;
        return explained_by_time(self, turn, past->rate_world);
    }
    return true;
}

/* PoseFusion._fuse: position, then attitude. True if the pose was used. */
static bool fuse(PoseFusion *self, const PoseSurroundings *at, const Pose *pose, const real innovation[3],
                 int64_t capture_ns, int64_t now_ns, real time_sigma_s) {
    const EstimatorConfig *config = &self->config;
    ErrorStateFilter *filter = at->filter;
    real before[3];
    vector_copy(filter->position, before);
    real delay_s = (real)(at->state->last_imu_ns - capture_ns) * REAL(1e-9);
    real sigma_s = real_max(config->pose_time_sigma_s, time_sigma_s);
    real variance = square(config->pose_position_sigma_m) + square(sigma_s) * vector_squared_length(filter->velocity);
    if (at->state->vibration > config->vibration_white_max_m_s2) {
        widen_velocity(self, filter, innovation, delay_s);
    }
    variance = softened(variance, vector_squared_length(innovation), config->pose_near_m, config->pose_gate);
    real score = filter_correct_position(filter, innovation, delay_s, variance, config->pose_gate);
    corrections_note_score(at->corrections, AID_POSE_POSITION, score, config->pose_gate, 3);
    if (score > config->pose_gate) {
        return false;
    }
    corrections_announce_jump(at->corrections, filter, at->state, before, AID_POSE_POSITION, now_ns, REAL(0.0), false);
    PastState past;
    if (!filter_at(filter, capture_ns, &past)) {
        return true;
    }
    if (stuck_gyro_any(at->gyro)) {
        fuse_attitude_of_lost_axis(self, at, pose, &past, capture_ns, time_sigma_s);
        return true;
    }
    return fuse_attitude(self, at, pose, &past, time_sigma_s);
}

/* PoseFusion._accept */
static void accept(PoseFusion *self, VehicleState *state, int64_t now_ns) {
    self->had_pose = true;
    self->trust.drifting = self->trust.blind = false;
    state->last_pose_ns = state->last_velocity_aid_ns = state->last_height_ns = now_ns;
}

/* PoseFusion._jump_to: set position and attitude to a pose. The velocity stays; its uncertainty grows, except at the first
 * pose. */
static void jump_to(PoseFusion *self, const PoseSurroundings *at, const Pose *pose, int64_t capture_ns,
                    int64_t now_ns) {
    const real still[3] = {REAL(0.0), REAL(0.0), REAL(0.0)};
    ErrorStateFilter *filter = at->filter;
    PastState past;
    if (!filter_at(filter, capture_ns, &past)) {
        return;
    }
    real turn[3], before[3], step[3], yaw = at->state->euler[2];
    rotation_between(pose->quaternion, past.rotation, turn);
    if (self->had_pose && explained_by_time(self, turn, past.rate_world)) {
        vector_zero(turn);
    }
    vector_copy(filter->position, before);
    vector_subtract(pose->position, past.position, step);
    real age_s = (real)(now_ns - at->state->last_pose_ns) * REAL(1e-9);
    pose_trust_note_jump(&self->trust, step, age_s, now_ns);
    filter_shift(filter, step, still, turn);
    /* The velocity turns with the frame: what flow measured was in the body frame. */
    turned_about_vertical(turn, filter->velocity, filter->velocity);
    filter_restart_error(filter, POSITION, REAL(2.0) * self->config.pose_position_sigma_m);
    if (vector_squared_length(turn) != REAL(0.0)) {
        filter_restart_error(filter, ATTITUDE, REAL(2.0) * self->config.pose_attitude_sigma_rad);
    }
    if (self->had_pose) {
        filter_restart_error(filter, VELOCITY, REAL(0.0));
        filter_inflate_motion(filter, REAL(1.0), (real)(at->state->last_imu_ns - capture_ns) * REAL(1e-9));
    }
    if (vector_length(turn) > LARGE_TURN_RAD) {
        filter_forget_history(filter);
    }
    self->jumps++;
    accept(self, at->state, now_ns);
    state_publish_attitude(at->state, filter);
    corrections_announce_jump(at->corrections, filter, at->state, before, AID_POSE_POSITION, now_ns,
                              at->state->euler[2] - yaw, true);
}

/* PoseFusion._refuse: count a refused pose; jump to it if enough of them in a row agree */
static void refuse(PoseFusion *self, const PoseSurroundings *at, const Pose *pose, int64_t capture_ns, int64_t now_ns) {
    real apart[3];
    vector_subtract(pose->position, self->refused_position, apart);
    bool agrees = vector_length(apart) < self->config.pose_agree_m;
    vector_copy(pose->position, self->refused_position);
    self->refused_in_a_row = agrees && self->refused_in_a_row > 0 ? self->refused_in_a_row + 1 : 1;
    self->refused++;
    if (self->refused_in_a_row >= self->config.pose_reset_count) {
        self->refused_in_a_row = 0;
        jump_to(self, at, pose, capture_ns, now_ns);
    }
}

/* PoseFusion.receive */
void pose_fusion_receive(PoseFusion *self, const PoseSurroundings *at, const Pose *pose, int64_t capture_ns,
                         int64_t now_ns, real time_sigma_s) {
    if (capture_ns <= self->last_capture_ns) {
        self->out_of_order++;
        return;
    }
    PastState past;
    bool timely = now_ns - capture_ns <= self->delay_max_ns && capture_ns - now_ns <= FUTURE_NS;
    if (!timely || !filter_at(at->filter, capture_ns, &past)) {
        self->wrong_time++;
        return;
    }
    self->last_capture_ns = capture_ns;
    real innovation[3];
    vector_subtract(pose->position, past.position, innovation);
    if (is_implausible(self, at, pose, &past, innovation, now_ns)) {
        self->implausible++;
        self->refused++;
        return;
    }
    if (self->had_pose && fuse(self, at, pose, innovation, capture_ns, now_ns, time_sigma_s)) {
        self->refused_in_a_row = 0;
        self->used++;
        accept(self, at->state, now_ns);
        return;
    }
    refuse(self, at, pose, capture_ns, now_ns);
}
