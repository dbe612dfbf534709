#include "control/cascade.h"

#include <string.h>

#include "generated/constants.h"
#include "numerics/elementary.h"
#include "protocol/geometry.h"

enum { PLACE, TURN }; /* the channels */

static const real NOTHING[3] = {REAL(0.0), REAL(0.0), REAL(0.0)};

/* CascadedController.__init__ */
void cascade_init(Cascade *self, const CascadeSettings *settings, const AirframeConfig *airframe,
                  const ChannelFeatures *start) {
    memset(self, 0, sizeof *self);
    self->settings = *settings;
    self->airframe = *airframe;
    const ChannelGains *position = &settings->position.gains, *attitude = &settings->attitude.gains;
    position_model_init(&self->position_model, position);
    attitude_model_init(&self->attitude_model, attitude);
    gains_stiffness(position, self->k1);
    gains_rate_gain(position, self->k2);
    gains_stiffness(attitude, self->a1);
    gains_rate_gain(attitude, self->a2);
    demand_limits_init(&self->limits, &settings->limits);
    tracking_bounds_init(&self->bounds, position, attitude);
    self->output.commanded_quaternion[0] = REAL(1.0);
    command_motion_init(&self->motion, settings->command_rate_filter_s, settings->path_turn);
    augmentation_init(self->augmentations + PLACE, settings, PLACE, start + PLACE);
    augmentation_init(self->augmentations + TURN, settings, TURN, start + TURN);
    guard_init(&self->guard, &settings->guard, self->augmentations, position, attitude, airframe,
               settings->limits.tilt_max_rad);
}

/* CascadedController.accepts_features */
bool cascade_accepts_features(const Cascade *self) {
    return augmentation_learns(self->augmentations + PLACE) || augmentation_learns(self->augmentations + TURN);
}

/* CascadedController.begin_features, .cancel_features */
void cascade_begin_features(Cascade *self) {
    guard_begin(&self->guard);
}

/* CascadedController.advance_features */
bool cascade_advance_features(Cascade *self, const FeatureSet *features, Refusal *refusal) {
    return guard_advance(&self->guard, self->augmentations, features, refusal);
}

/* CascadedController.offer_features */
Refusal cascade_offer_features(Cascade *self, const FeatureSet *features) {
    return guard_offer(&self->guard, self->augmentations, features);
}

/* CascadedController.take_falls */
int32_t cascade_take_falls(Cascade *self, Fall *falls) {
    return guard_take_falls(&self->guard, falls);
}

static ChannelTelemetry *telemetry_of(Cascade *self, int channel) {
    return channel == PLACE ? &self->output.position : &self->output.attitude;
}

/* nu_ad of a channel's law, guarded */
static void guarded_step(Cascade *self, int channel, const ControlInputs *inputs, real nu_ad[3]) {
    guard_step(&self->guard, self->augmentations, channel, self->channels + channel, telemetry_of(self, channel),
               inputs, nu_ad);
}

/* --- the channels' inputs --- */

/* CascadedController._track: the position part is limited per axis */
static void track(Cascade *self, const ControlInputs *inputs) {
    const VehicleState *state = inputs->state;
    const PathPoint *target = &inputs->target->now;
    real limit = self->settings.position_error_max_m, *error = self->channels[PLACE].tracking_error;
    for (int i = 0; i < 3; i++) {
        error[i] = real_clip(target->position[i] - state->position[i], -limit, limit);
        error[3 + i] = target->velocity[i] - state->velocity[i];
    }
}

/* CascadedController._set_motion: position and velocity (world NED) in the signals `column`, at the present attitude */
static void set_motion(const ControlInputs *inputs, const real position[3], const real velocity[3], real *column) {
    const real *R = inputs->state->rotation, *v = velocity;
    memcpy(column, inputs->signals, SIGNAL_COUNT * sizeof(real));
    for (int i = 0; i < 3; i++) {
        column[SIGNAL_POSITION_N + i] = position[i];
        column[SIGNAL_VELOCITY_N + i] = velocity[i];
        column[SIGNAL_BODY_VELOCITY_X + i] = R[i] * v[0] + R[3 + i] * v[1] + R[6 + i] * v[2];
    }
}

/* CascadedController._see_ahead: x_ahead = x + (x_d(t + t_ahead) - x_d(t)) */
static void see_ahead(const ControlInputs *inputs, const PathPoint *there, real *column) {
    const PathPoint *now = &inputs->target->now;
    const VehicleState *state = inputs->state;
    real position[3], velocity[3];
    for (int i = 0; i < 3; i++) {
        position[i] = state->position[i] + there->position[i] - now->position[i];
        velocity[i] = state->velocity[i] + there->velocity[i] - now->velocity[i];
    }
    set_motion(inputs, position, velocity, column);
}

/* CascadedController._look_ahead, of one channel: the states that its law sees */
static void look_ahead(const ControlInputs *inputs, const PathPoint *there, bool reads_path, ChannelState *channel) {
    const PathPoint *now = &inputs->target->now;
    memcpy(channel->signals, inputs->signals, sizeof channel->signals);
    if (reads_path) {
        set_motion(inputs, there->position, there->velocity, channel->signals_ahead);
        set_motion(inputs, now->position, now->velocity, channel->signals_path);
    } else {
        see_ahead(inputs, there, channel->signals_ahead);
    }
}

static void read_channel(ChannelState *channel, const ControlInputs *inputs, const ChannelMeasurement *measured,
                         const real rate[3]) {
    channel->dt = inputs->dt;
    channel->adapt = inputs->adapt;
    channel->saturated = inputs->saturated;
    vector_copy(measured->u_hat, channel->u_hat);
    vector_copy(measured->residual, channel->residual);
    vector_copy(rate, channel->rate);
    channel->lap_phase = inputs->target->lap_phase;
    channel->lap_s = inputs->target->lap_s;
}

/* CascadedController._read */
static void read_inputs(Cascade *self, const ControlInputs *inputs) {
    read_channel(self->channels + PLACE, inputs, inputs->position, inputs->state->velocity);
    read_channel(self->channels + TURN, inputs, inputs->attitude, inputs->state->rates);
    const Augmentation *place = self->augmentations + PLACE, *turn = self->augmentations + TURN;
    if (augmentation_has_features(place) || augmentation_has_features(turn)) {
        const Target *target = inputs->target;
        look_ahead(inputs, &target->ahead, augmentation_reads_path(place), self->channels + PLACE);
        look_ahead(inputs, &target->attitude_ahead, augmentation_reads_path(turn), self->channels + TURN);
    }
    track(self, inputs);
}

/* --- reference models --- */

/* CascadedController._restart_models */
static void restart_models(Cascade *self, const ControlInputs *inputs) {
    const VehicleState *state = inputs->state;
    position_model_reset(&self->position_model, state->position, state->velocity);
    attitude_model_reset(&self->attitude_model, state->quaternion, state->rates);
    self->resets_seen = state->position_reset_count;
    memset(self->channels[PLACE].model_error, 0, sizeof self->channels[PLACE].model_error);
    memset(self->channels[TURN].model_error, 0, sizeof self->channels[TURN].model_error);
}

/* CascadedController._follow_jump: move the references with a jump of the estimate (true), or reset them where its size is
 * not known (false): yaw has jumped as well, or the position more than once */
static bool follow_jump(Cascade *self, const ControlInputs *inputs) {
    const VehicleState *state = inputs->state;
    if (state->position_reset_count != self->resets_seen + 1 || state->yaw_jump != REAL(0.0)) {
        restart_models(self, inputs);
        return false;
    }
    position_model_shift(&self->position_model, state->position_jump);
    for (int i = 0; i < 3; i++) {
        self->command[i] += self->k1[i] * state->position_jump[i];
    }
    self->resets_seen = state->position_reset_count;
    return true;
}

/* CascadedController._hedge: u - u_hat, all that was not delivered, or only what limits took of the last demand:
 * `limited`, and all while motors are at theirs */
static void hedge_of(Cascade *self, int channel, const real limited[3], real hedge[3]) {
    vector_zero(hedge);
    if (self->settings.hedging == CASCADE_SETTINGS_HEDGING_NONE) {
        return;
    }
    if (self->settings.hedging == CASCADE_SETTINGS_HEDGING_LIMITS && !self->channels[channel].saturated) {
        vector_copy(limited, hedge);
        return;
    }
    vector_subtract(telemetry_of(self, channel)->demand, self->channels[channel].u_hat, hedge);
}

/* CascadedController._advance_models */
static void advance_models(Cascade *self, const ControlInputs *inputs) {
    const VehicleState *state = inputs->state;
    real *position_error = self->channels[PLACE].model_error, *e = self->channels[TURN].model_error, hedge[3];
    if (!inputs->adapt || !self->running) {
        restart_models(self, inputs);
        self->running = inputs->adapt;
        return;
    }
    if (state->position_reset_count != self->resets_seen && !follow_jump(self, inputs)) {
        return;
    }
    hedge_of(self, PLACE, self->limited, hedge);
    position_model_step(&self->position_model, self->command, hedge, inputs->dt);
    position_model_error(&self->position_model, state->position, state->velocity, position_error);
    hedge_of(self, TURN, NOTHING, hedge);
    attitude_model_step(&self->attitude_model, self->turn_command, hedge, inputs->dt);
    attitude_model_error(&self->attitude_model, state->quaternion, state->rates, e);
    if (inputs->dt > MODEL_GAP_MAX_S || vector_squared_length(e) > MODEL_ERROR_MAX_RAD * MODEL_ERROR_MAX_RAD) {
        attitude_model_reset(&self->attitude_model, state->quaternion, state->rates);
        memset(e, 0, sizeof self->channels[TURN].model_error);
    }
}

/* --- the loops --- */

/* CascadedController._position_loop: u = K_1 (p_d - p) + K_2 (v_d - v) + a_ff - nu_ad, m/s^2, world NED */
static void position_loop(Cascade *self, const ControlInputs *inputs) {
    ChannelTelemetry *telemetry = &self->output.position;
    const real *e = self->channels[PLACE].tracking_error, *p = inputs->state->position, *v = inputs->state->velocity;
    real nu_ad[3], *u = telemetry->demand;
    guarded_step(self, PLACE, inputs, nu_ad);
    for (int i = 0; i < 3; i++) {
        u[i] = self->k1[i] * e[i] + self->k2[i] * e[3 + i] + inputs->target->feed_forward[i] - nu_ad[i];
    }
    if (inputs->level_only) {
        u[0] = u[1] = REAL(0.0);
        u[2] = self->k2[2] * (self->settings.level_sink_speed_m_s - v[2]) - nu_ad[2];
    }
    /* K_r r = u + K x + nu_ad, with nu_ad of the present state: what the look-ahead adds is part of the command. */
    for (int i = 0; i < 3; i++) {
        self->command[i] = u[i] + self->k1[i] * p[i] + self->k2[i] * v[i] + telemetry->adaptive_now[i];
    }
}

/* CascadedController._thrust_vector: collective thrust along the present body axis, and the attitude for u, within the
 * limits */
static void thrust_vector(Cascade *self, const ControlInputs *inputs) {
    const real *u = self->output.position.demand, *R = inputs->state->rotation;
    real f[3], down[3];
    demand_limits_step(&self->limits, inputs->adapt, inputs->position->residual[2], inputs->dt);
    demand_limits_specific_thrust(&self->limits, u, self->output.position.adaptive[2], f);
    real norm = vector_length(f);
    vector_add(u, f, self->limited);
    self->limited[2] -= GRAVITY;
    for (int i = 0; i < 3; i++) {
        down[i] = f[i] / norm;
    }
    attitude_for_thrust(down, inputs->target->yaw_rad, self->output.commanded_quaternion);
    const real axis[3] = {R[2], R[5], R[8]};
    self->output.thrust_n = self->airframe.mass_kg * thrust_along(f, axis);
}

/* CascadedController._predicted: attitude and rates when the command of this tick acts, half a tick after the next begins */
static void predict(const Cascade *self, const ControlInputs *inputs, real quaternion[4], real omega[3]) {
    const real *nu = self->output.attitude.adaptive_now, *rates = inputs->state->rates;
    memcpy(quaternion, inputs->state->quaternion, sizeof inputs->state->quaternion);
    vector_copy(rates, omega);
    if (!self->settings.prediction) {
        return;
    }
    real dt = inputs->dt / (real)(1 + inputs->missed), delay = self->settings.gyro_delay_ticks;
    const real *now = inputs->coming_now, *next = inputs->coming_next;
    const real *before = inputs->missed > 0 ? now : inputs->attitude->u_hat;
    real h = REAL(0.5) * REAL(1.5) * dt, turn[4] = {REAL(1.0)};
    for (int i = 0; i < 3; i++) {
        real here = rates[i] + delay * dt * (before[i] + nu[i]);
        omega[i] = here + dt * (REAL(0.5) * (now[i] + next[i]) + nu[i]) + REAL(0.5) * dt * (next[i] + nu[i]);
        turn[1 + i] = h * REAL(0.5) * (here + omega[i]);
    }
    quaternion_multiply(quaternion, turn, quaternion);
}

/* CascadedController._attitude_loop: u = K_1 e_R - K_2 (omega - omega_d) + alpha_d - nu_ad, rad/s^2;
 * tau = J u + omega x J omega, N m; body FRD */
static void attitude_loop(Cascade *self, const ControlInputs *inputs) {
    ChannelTelemetry *telemetry = &self->output.attitude;
    const CommandMotion *motion = &self->motion;
    real quaternion[4], omega[3], nu_ad[3], *e = self->channels[TURN].tracking_error, *u = telemetry->demand;
    predict(self, inputs, quaternion, omega);
    turn_between(quaternion, self->output.commanded_quaternion, e);
    e[2] = real_clip(e[2], -YAW_ERROR_MAX_RAD, YAW_ERROR_MAX_RAD);
    vector_scale(omega, REAL(-1.0), e + 3);
    guarded_step(self, TURN, inputs, nu_ad);
    command_motion_step(&self->motion, self->output.commanded_quaternion, inputs);
    for (int i = 0; i < 3; i++) {
        u[i] = self->a1[i] * e[i] - self->a2[i] * (omega[i] - motion->omega_d[i]) + motion->alpha_d[i] - nu_ad[i];
        self->turn_command[i] = u[i] + telemetry->adaptive_now[i];
    }
    const real *J = self->airframe.inertia_kg_m2;
    real p = omega[0], q = omega[1], r = omega[2], *torque = self->output.torque_nm;
    torque[0] = J[0] * u[0] + (J[2] - J[1]) * q * r;
    torque[1] = J[1] * u[1] + (J[0] - J[2]) * p * r;
    torque[2] = J[2] * u[2] + (J[1] - J[0]) * p * q;
}

/* CascadedController.step */
void cascade_step(Cascade *self, const ControlInputs *inputs) {
    ControlOutput *output = &self->output;
    real bounds[2];
    read_inputs(self, inputs);
    advance_models(self, inputs);
    position_loop(self, inputs);
    thrust_vector(self, inputs);
    attitude_loop(self, inputs);
    output->law = (int32_t)self->guard.level;
    guard_judge(&self->guard, self->augmentations, inputs->dt, inputs->adapt, inputs->busy);
    tracking_bounds_step(&self->bounds, inputs, output->commanded_quaternion, &self->motion, bounds);
    output->position.tracking_bound = bounds[PLACE];
    output->attitude.tracking_bound = bounds[TURN];
    memcpy(output->position.error, self->channels[PLACE].model_error, sizeof output->position.error);
    memcpy(output->attitude.error, self->channels[TURN].model_error, sizeof output->attitude.error);
}

/* CascadedController.reset */
void cascade_reset(Cascade *self, const ControlInputs *inputs) {
    restart_models(self, inputs);
    demand_limits_reset(&self->limits);
    tracking_bounds_reset(&self->bounds);
    guard_reset(&self->guard);
    augmentation_reset(self->augmentations + PLACE);
    augmentation_reset(self->augmentations + TURN);
}
