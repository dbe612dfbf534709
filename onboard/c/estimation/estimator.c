#include "estimation/estimator.h"

#include <math.h>
#include <string.h>

#include "numerics/elementary.h"
#include "numerics/whole.h"
#include "protocol/geometry.h"

#define AROUND(self) (&(PoseSurroundings){&(self)->filter, &(self)->state, &(self)->corrections, &(self)->gyro})
#define ALWAYS REAL(HUGE_VAL) /* a gate that accepts everything */

static real square(real x) {
    return x * x;
}

/* Estimator.__init__ */
void estimator_init(Estimator *self, const EstimatorConfig *config) {
    memset(self, 0, sizeof *self);
    state_init(&self->state);
    self->config = *config;
    filter_init(&self->filter, config->covariance_every);
    corrections_init(&self->corrections, config);
    stuck_gyro_init(&self->gyro, config->gyro_stuck_samples, config->gyro_stuck_disturbance_s);
    pose_fusion_init(&self->poses, config);
    calibration_init(&self->calibration, config);
    still_start_init(&self->start, config->start_samples, config->start_rate_max_rad_s);
    vibration_init(&self->vibration);
    self->aid_fresh_ns = nanoseconds_below(config->aid_fresh_s);
    self->recovery_ns = nanoseconds_below(config->recovery_s);
    self->on_ground = self->at_rest = true;
}

/* Estimator.healthy */
bool estimator_healthy(const Estimator *self) {
    const ErrorStateFilter *f = &self->filter;
    real sum = f->quaternion[0] + f->quaternion[1] + f->quaternion[2] + f->quaternion[3];
    for (int i = 0; i < 3; i++) {
        sum += f->position[i] + f->velocity[i] + f->gyro_bias[i];
    }
    return real_is_finite(sum);
}

/* Estimator.set_on_ground */
void estimator_set_on_ground(Estimator *self, bool on_ground, bool at_rest) {
    self->on_ground = on_ground;
    if (at_rest != self->at_rest) {
        self->at_rest = at_rest;
        calibration_interrupt(&self->calibration);
    }
    self->corrections.in_flight = !on_ground;
}

/* Estimator.expect_turn */
void estimator_expect_turn(Estimator *self, const real u_hat[3], const real residual[3], real dt) {
    stuck_gyro_expect(&self->gyro, u_hat, residual, dt);
}

/* Estimator.take_events */
int32_t estimator_take_events(Estimator *self, EstimatorEvent *events) {
    EstimatorEvents *waiting = &self->corrections.events;
    int32_t count = waiting->count;
    memcpy(events, waiting->events, (size_t)count * sizeof *events);
    waiting->count = 0;
    return count;
}

/* A gated scalar correction of one error: Corrections.correct with an index */
static bool correct_component(Estimator *self, Aid aid, int32_t index, real innovation, real variance, real gate,
                              int64_t now_ns) {
    real before[3];
    vector_copy(self->filter.position, before);
    real score = filter_correct_component(&self->filter, index, innovation, variance, gate);
    return corrections_conclude(&self->corrections, &self->filter, &self->state, aid, score, gate, before, now_ns);
}

/* --- inertial sensors --- */

/* Estimator._find_start: wait for still samples in a row, then set attitude and gyro bias from their means */
static void find_start(Estimator *self, const ImuReading *reading) {
    const EstimatorConfig *config = &self->config;
    if (!still_start_add(&self->start, reading)) {
        return;
    }
    real angles[2], quaternion[4], rate[3], sigmas[ERROR_SIZE];
    still_start_level(&self->start, angles);
    still_start_mean_rate(&self->start, rate);
    for (int i = 0; i < 3; i++) {
        sigmas[POSITION + i] = config->start_position_sigma_m;
        sigmas[VELOCITY + i] = config->still_velocity_sigma_m_s;
        sigmas[ATTITUDE + i] = i < 2 ? config->start_tilt_sigma_rad : config->start_yaw_sigma_rad;
        sigmas[GYRO_BIAS + i] = config->start_gyro_bias_sigma;
        sigmas[ACCELEROMETER_BIAS + i] = config->start_accelerometer_bias_sigma;
    }
    quaternion_of(angles[0], angles[1], REAL(0.0), quaternion);
    filter_start(&self->filter, quaternion, rate, sigmas);
    self->state.initialised = true;
    EstimatorEvent *event = estimator_report(&self->corrections.events, reading->time_ns, ESTIMATOR_FOUND_ATTITUDE, 0);
    event->values[0] = angles[0];
    event->values[1] = angles[1];
    state_publish(&self->state, &self->filter, reading);
}

/* Estimator._use_calibration: the gyro bias as found; specific force = gravity + bias as a measurement of tilt and
 * accelerometer bias: innovation f + g R^T e_d - b = R^T [a]x phi + db + noise */
static void use_calibration(Estimator *self, const Calibration *found) {
    const EstimatorConfig *config = &self->config;
    ErrorStateFilter *f = &self->filter;
    real share = REAL(1.0) / real_sqrt((real)found->samples);
    vector_copy(found->rate, f->gyro_bias);
    filter_restart_error(f, GYRO_BIAS, config->gyro_sigma * share);
    filter_restart_error(f, ACCELEROMETER_BIAS, config->start_accelerometer_bias_sigma); /* no sample counts twice */
    for (int axis = 0; axis < 3; axis++) {
        real h[ERROR_SIZE] = {REAL(0.0)};
        real to_north = f->rotation[axis], to_east = f->rotation[3 + axis], to_down = f->rotation[6 + axis];
        h[ATTITUDE] = -GRAVITY * to_east;
        h[ATTITUDE + 1] = GRAVITY * to_north;
        h[ACCELEROMETER_BIAS + axis] = REAL(1.0);
        real innovation = found->force[axis] + GRAVITY * to_down - f->accelerometer_bias[axis];
        filter_correct_scalar(f, h, innovation, square(REAL(3.0) * config->accelerometer_sigma * share), ALWAYS);
    }
}

/* Estimator._calibrate: collect a sample at rest; use a calibration that it completes */
static void calibrate(Estimator *self, const ImuReading *reading) {
    int32_t known = self->calibration.count;
    calibration_add(&self->calibration, reading, &self->corrections.events);
    if (self->calibration.count != known) {
        use_calibration(self, &self->calibration.accepted);
    }
}

/* Estimator._bridge_gap: increase the uncertainty after missing samples; returns the time step to integrate over */
static real bridge_gap(Estimator *self, int64_t time_ns, real gap_s) {
    real seconds = real_min(gap_s, REAL(5.0));
    self->imu_gaps++;
    self->poses.trust.blind = true;
    filter_inflate(&self->filter, VELOCITY, REAL(3.0) * seconds, 3);
    filter_inflate(&self->filter, POSITION, REAL(1.5) * seconds * seconds, 3);
    filter_inflate(&self->filter, ATTITUDE, REAL(0.5) * seconds, 3);
    estimator_report(&self->corrections.events, time_ns, ESTIMATOR_GAP, 0)->values[0] = gap_s;
    return real_min(gap_s, GAP_MAX_S);
}

/* Estimator._lose_axis: undo what a stuck axis has done to the attitude, and report it */
static void lose_axis(Estimator *self, int32_t axis, real turn_rad, bool first, int64_t now_ns) {
    const real still[3] = {REAL(0.0), REAL(0.0), REAL(0.0)};
    ErrorStateFilter *f = &self->filter;
    real turn[3] = {REAL(0.0), REAL(0.0), REAL(0.0)};
    turn[axis] = turn_rad;
    if (first) {
        vector_copy(f->gyro_bias, self->bias_before);
    }
    matrix_times(f->rotation, turn, turn);
    filter_shift(f, still, still, turn);
    filter_inflate(f, GYRO_BIAS + axis, RATE_SIGMA, 1);
    filter_inflate(f, ATTITUDE, TURN_SIGMA, 3);
    estimator_report(&self->corrections.events, now_ns, ESTIMATOR_GYRO_STUCK, axis);
}

/* Estimator._with_good_rates: the reading, with the rate of a stuck axis replaced by one from the motors */
static void replace_bad_rates(Estimator *self, ImuReading *reading, real dt) {
    StuckGyro *gyro = &self->gyro;
    bool any_before = stuck_gyro_any(gyro);
    FoundAxes found;
    stuck_gyro_receive(gyro, reading->gyroscope, reading->accelerometer, dt, !self->on_ground, &found);
    for (int32_t i = 0; i < found.count; i++) {
        bool only = !any_before && found.count == 1;
        lose_axis(self, found.axis[i], found.turn_rad[i], only, reading->time_ns);
    }
    if (!stuck_gyro_any(gyro)) {
        return;
    }
    if (self->on_ground) {
        vector_copy(self->bias_before, self->filter.gyro_bias);
        stuck_gyro_reset(gyro);
        return;
    }
    for (int axis = 0; axis < 3; axis++) {
        if (gyro->stuck[axis]) {
            filter_inflate(&self->filter, GYRO_BIAS + axis, self->config.gyro_stuck_walk * real_sqrt(dt), 1);
        }
    }
    stuck_gyro_note_bias(gyro, self->filter.gyro_bias, reading->time_ns, dt);
    stuck_gyro_replaced(gyro, reading->gyroscope, reading->gyroscope);
}

/* Estimator._fuse_ground: on the ground: velocity 0, rate = bias, height 0 */
static void fuse_ground(Estimator *self, int32_t turn, const ImuReading *reading) {
    const EstimatorConfig *config = &self->config;
    ErrorStateFilter *f = &self->filter;
    self->state.last_velocity_aid_ns = reading->time_ns;
    if (turn < 3) {
        real variance = square(config->still_velocity_sigma_m_s);
        filter_correct_component(f, VELOCITY + turn, -f->velocity[turn], variance, ALWAYS);
    } else if (turn < 6) {
        real innovation = reading->gyroscope[turn - 3] - f->gyro_bias[turn - 3];
        if (real_abs(innovation) < config->start_rate_max_rad_s) { /* else a person is carrying the vehicle */
            real variance = square(REAL(3.0) * config->gyro_sigma);
            filter_correct_component(f, GYRO_BIAS + turn - 3, innovation, variance, ALWAYS);
        }
    } else if (reading->time_ns - self->state.last_pose_ns > self->recovery_ns) {
        filter_correct_component(f, POSITION + 2, -f->position[2], square(config->still_height_sigma_m), ALWAYS);
    }
}

/* Estimator._fuse_pressure: height from pressure. While a better height is known, the zero of the pressure follows it. */
static void fuse_pressure(Estimator *self, int64_t now_ns) {
    const EstimatorConfig *config = &self->config;
    if (self->pressure_count == 0) {
        return;
    }
    real pressure_pa = self->pressure_sum / (real)self->pressure_count;
    self->pressure_sum = REAL(0.0);
    self->pressure_count = 0;
    real zero_pa = pressure_pa - AIR_PA_PER_M * self->filter.position[2];
    if (self->pressure_zero_pa == REAL(0.0)) {
        self->pressure_zero_pa = zero_pa;
    }
    real off_pa = zero_pa - self->pressure_zero_pa;
    pose_trust_note_pressure(&self->poses.trust, off_pa / AIR_PA_PER_M, now_ns);
    if (self->on_ground || now_ns - self->state.last_height_ns < self->aid_fresh_ns) {
        real score = square(off_pa / config->pressure_sigma_pa);
        corrections_note_score(&self->corrections, AID_PRESSURE, score, config->pressure_gate, 1);
        self->pressure_zero_pa += REAL(0.02) * off_pa;
        return;
    }
    /* Means of neighbouring samples have the same drift, so they count as one independent value a second. */
    real noise_pa = real_sqrt(square(config->pressure_sigma_pa) + square(config->pressure_drift_pa));
    real innovation_m = off_pa / AIR_PA_PER_M, variance = square(REAL(5.0) * noise_pa / AIR_PA_PER_M);
    correct_component(self, AID_PRESSURE, POSITION + 2, innovation_m, variance, config->pressure_gate, now_ns);
}

/* Estimator._fuse_slow_aid */
static void fuse_slow_aid(Estimator *self, const ImuReading *reading) {
    int32_t turn = self->turn;
    if (turn == PRESSURE_TURN) {
        fuse_pressure(self, reading->time_ns);
    } else if (self->on_ground) {
        fuse_ground(self, turn, reading);
    } else if (turn < 3 && reading->time_ns - self->state.last_velocity_aid_ns > self->recovery_ns) {
        real variance = square(self->config.unaided_velocity_sigma_m_s);
        filter_correct_component(&self->filter, VELOCITY + turn, -self->filter.velocity[turn], variance, ALWAYS);
    }
}

/* The noise of a sample; that of the accelerometer grows with vibration. */
static ImuNoise noise_now(const Estimator *self) {
    const EstimatorConfig *config = &self->config;
    real sigma = real_max(config->accelerometer_sigma, config->vibration_to_sigma * self->state.vibration);
    return (ImuNoise){real_min(sigma, config->accelerometer_sigma_max), config->gyro_sigma, config->gyro_bias_walk,
                      config->accelerometer_bias_walk};
}

/* Estimator._receive_imu */
void estimator_receive_imu(Estimator *self, const ImuReading *received) {
    VehicleState *state = &self->state;
    ImuReading reading = *received;
    bool first = state->last_imu_ns == NEVER_NS;
    real dt = (real)(reading.time_ns - state->last_imu_ns) * REAL(1e-9);
    if (dt <= REAL(0.0)) {
        self->imu_out_of_order++;
        return;
    }
    state->last_imu_ns = reading.time_ns;
    if (self->at_rest) {
        calibrate(self, &reading);
    }
    if (!state->initialised) {
        find_start(self, &reading);
        return;
    }
    if (first || dt > self->config.gap_s) {
        dt = bridge_gap(self, reading.time_ns, dt);
    }
    state->vibration = vibration_update(&self->vibration, reading.accelerometer, dt);
    replace_bad_rates(self, &reading, dt);
    ImuNoise noise = noise_now(self);
    filter_predict(&self->filter, reading.time_ns, dt, reading.accelerometer, reading.gyroscope, &noise,
                   self->config.gyro_delay_s);
    if (reading.has_pressure) {
        self->pressure_sum += reading.pressure_pa;
        self->pressure_count++;
    }
    self->turn = (self->turn + 1) % SLOW_AIDS;
    fuse_slow_aid(self, &reading);
    state_publish(state, &self->filter, &reading);
    state->height_valid = reading.time_ns - state->last_height_ns < 2 * self->aid_fresh_ns;
    if (self->turn == 0) {
        state_publish_sigmas(state, &self->filter);
    }
}

/* --- optical flow, range and poses --- */

/* Estimator._recover: after long refusal of an aid without a fresh pose: increase the uncertainty */
static void recover(Estimator *self, Aid aid, int32_t start, int32_t size, int64_t now_ns) {
    bool pose_fresh = now_ns - self->state.last_pose_ns < self->aid_fresh_ns;
    if (corrections_refused_long(&self->corrections, aid, now_ns) && !pose_fresh) {
        corrections_widen(&self->corrections, &self->filter, aid, start, size, REAL(1.0), now_ns);
    }
}

/* Estimator._flow_rotation: the rotation in the flow, rad; that of a stuck axis is replaced as well */
static void flow_rotation(const Estimator *self, const FlowReading *reading, real rotation[2]) {
    const bool *stuck = self->gyro.stuck;
    rotation[0] = stuck[0] ? self->state.rates[0] * reading->integration_s : reading->rotation_x;
    rotation[1] = stuck[1] ? self->state.rates[1] * reading->integration_s : reading->rotation_y;
}

/* One of the two scalars of the flow: h and the expected body velocity along an axis. With a stuck axis the flow measures
 * the error of its rate, too: _flow_of_lost_rate. */
static real flow_row(const Estimator *self, const PastState *past, int axis, real distance_m, real h[ERROR_SIZE]) {
    const real *v = past->velocity;
    real rx = past->rotation[axis], ry = past->rotation[3 + axis], rz = past->rotation[6 + axis];
    memset(h, 0, ERROR_SIZE * sizeof(real));
    h[VELOCITY] = rx;
    h[VELOCITY + 1] = ry;
    h[VELOCITY + 2] = rz;
    h[ATTITUDE] = ry * v[2] - rz * v[1];
    h[ATTITUDE + 1] = rz * v[0] - rx * v[2];
    h[ATTITUDE + 2] = rx * v[1] - ry * v[0];
    if (axis == 0 && self->gyro.stuck[1]) {
        h[GYRO_BIAS + 1] = -distance_m;
    } else if (axis == 1 && self->gyro.stuck[0]) {
        h[GYRO_BIAS] = distance_m;
    }
    return rx * v[0] + ry * v[1] + rz * v[2];
}

/* Estimator._receive_flow: velocity over ground, two scalars in the body frame at the middle of the exposure.
 * v_x = d (flow_y - rotation_y) / dt, v_y = -d (flow_x - rotation_x) / dt, d the distance along body z */
void estimator_receive_flow(Estimator *self, const FlowReading *reading) {
    const EstimatorConfig *config = &self->config;
    int64_t now_ns = reading->time_ns;
    PastState past;
    if (!self->state.initialised || self->on_ground || reading->quality < config->flow_quality_min) {
        return;
    }
    int64_t middle_ns = now_ns - (int64_t)(0.5e9 * (double)reading->integration_s);
    if (!filter_at(&self->filter, middle_ns, &past) || past.rotation[8] < COS_TILT_MIN) {
        return;
    }
    real distance_m = -past.position[2] / past.rotation[8];
    if (distance_m < config->flow_height_min_m) {
        return;
    }
    real rotation[2], residual[2], h[ERROR_SIZE], scale = distance_m / reading->integration_s;
    flow_rotation(self, reading, rotation);
    const real measured[2] = {scale * (reading->flow_y - rotation[1]), -scale * (reading->flow_x - rotation[0])};
    bool used = true;
    for (int axis = 0; axis < 2; axis++) {
        real expected = flow_row(self, &past, axis, distance_m, h), before[3];
        real sigma = config->flow_rate_sigma_rad_s * distance_m + config->flow_scale_sigma * real_abs(expected);
        vector_copy(self->filter.position, before);
        residual[axis] = measured[axis] - expected;
        real score = filter_correct_scalar(&self->filter, h, residual[axis], sigma * sigma, config->flow_gate);
        used &= corrections_conclude(&self->corrections, &self->filter, &self->state, AID_FLOW, score,
                                     config->flow_gate, before, now_ns);
    }
    if (!used) {
        recover(self, AID_FLOW, VELOCITY, 3, now_ns);
    } else if (now_ns > self->state.last_velocity_aid_ns) {
        self->state.last_velocity_aid_ns = now_ns;
    }
    pose_trust_note_flow(&self->poses.trust, residual, past.rotation, now_ns);
    pose_fusion_check_drift(&self->poses, AROUND(self), now_ns);
}

/* Estimator._receive_range: height over a level floor at d = 0. The first echo comes from straight below while the tilt is
 * within the beam's cone, from its edge beyond it. */
void estimator_receive_range(Estimator *self, const RangeReading *reading) {
    const EstimatorConfig *config = &self->config;
    int64_t now_ns = reading->time_ns;
    PastState past;
    bool valid = config->range_floor_m + config->range_margin_m < reading->distance_m &&
                 reading->distance_m < config->range_max_m;
    if (!self->state.initialised || !filter_at(&self->filter, now_ns, &past) || self->on_ground || !valid ||
        past.rotation[8] < COS_TILT_MIN) {
        return;
    }
    real beyond = real_acos(real_min(REAL(1.0), past.rotation[8])) - config->range_half_cone_rad;
    real share = beyond > REAL(0.0) ? real_cos(beyond) : REAL(1.0);
    real down_m = -reading->distance_m * share, variance = square(config->range_sigma_m);
    real innovation = down_m - past.position[2];
    if (correct_component(self, AID_RANGE, POSITION + 2, innovation, variance, config->range_gate, now_ns)) {
        self->state.last_height_ns = now_ns;
    } else {
        recover(self, AID_RANGE, POSITION + 2, 1, now_ns);
    }
    pose_trust_note_range(&self->poses.trust, down_m, innovation, now_ns);
    pose_fusion_check_drift(&self->poses, AROUND(self), now_ns);
}

/* Estimator.receive_pose */
void estimator_receive_pose(Estimator *self, const Pose *pose, int64_t capture_ns, int64_t now_ns, real time_sigma_s) {
    if (self->state.initialised) {
        pose_fusion_receive(&self->poses, AROUND(self), pose, capture_ns, now_ns, time_sigma_s);
    }
}
