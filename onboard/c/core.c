#include "core.h"

#include <string.h>

#include "numerics/elementary.h"
#include "protocol/geometry.h"

static bool is_in(FlightMode mode, uint32_t modes) {
    return (UINT32_C(1) << mode & modes) != 0;
}

static real seconds_since(int64_t now_ns, int64_t then_ns) {
    return (real)((double)(now_ns - then_ns) * 1e-9);
}

/* OnboardCore.__init__ */
bool core_init(Core *self, const CoreConfig *config, const ChannelFeatures *start, uint64_t session, const uint8_t *key,
               int32_t key_size) {
    memset(self, 0, sizeof *self);
    self->airframe = config->airframe;
    self->whole_period_s = (double)config->period_ns * 1e-9;
    self->dt = self->period_s = (real)self->whole_period_s;
    estimator_init(&self->estimator, &config->estimator);
    supervisor_init(&self->supervisor, &config->supervisor);
    guidance_init(&self->guidance, &config->guidance, config->lissajous);
    actuators_init(&self->actuators, &config->airframe, self->period_s);
    thrust_scale_init(&self->thrust_scale, &config->thrust_scale, &config->airframe, self->period_s);
    uncertainty_init(&self->uncertainty, &config->airframe, self->period_s);
    signal_vector_init(&self->signals, self->period_s);
    reception_init(&self->reception);
    mixer_init(&self->mixer, &config->airframe);
    sampler_init(&self->samples, &config->samples);
    self->mode = MODE_BOOT;
    self->battery = (BatteryReading){NEVER_NS, REAL(0.0), REAL(-1.0)};
    cascade_init(&self->controller, &config->controller, &config->airframe, start);
    return offboard_link_init(&self->offboard, config, session, key, key_size);
}

/* --- receive --- */

void core_receive_imu(Core *self, const ImuReading *reading) {
    estimator_receive_imu(&self->estimator, reading);
}

void core_receive_flow(Core *self, const FlowReading *reading) {
    estimator_receive_flow(&self->estimator, reading);
}

void core_receive_range(Core *self, const RangeReading *reading) {
    estimator_receive_range(&self->estimator, reading);
}

void core_receive_battery(Core *self, const BatteryReading *reading) {
    self->battery = *reading;
}

/* OnboardCore._receive_offboard */
void core_receive_offboard(Core *self, const uint8_t *datagram, size_t size, int64_t arrival_ns, Received *received) {
    offboard_link_receive(&self->offboard, datagram, size, arrival_ns, received);
    if (received->peer_restarted) {
        reception_restart(&self->reception);
    }
    if (received->has_pose) {
        const DatedPose *dated = &received->pose;
        estimator_receive_pose(&self->estimator, &dated->pose, dated->taken_ns, dated->arrival_ns, dated->time_sigma_s);
    }
    if (received->has_chunk) {
        reception_receive(&self->reception, &received->chunk);
    }
}

void core_command(Core *self, Command command, int64_t now_ns, ArmingRefusal *refusal) {
    supervisor_command(&self->supervisor, command, now_ns, refusal);
}

/* --- the blocks --- */

/* OnboardCore._supervisor_inputs */
static void supervisor_inputs(const Core *self, const CoreInputs *inputs, SupervisorInputs *out) {
    const VehicleState *state = &self->estimator.state;
    int64_t now_ns = inputs->now_ns;
    real north = state->position[0], east = state->position[1];
    *out = (SupervisorInputs){
        .now_ns = now_ns,
        .imu_age_s = seconds_since(now_ns, state->last_imu_ns),
        .pose_age_s = seconds_since(now_ns, state->last_pose_ns),
        .velocity_aid_age_s = seconds_since(now_ns, state->last_velocity_aid_ns),
        .offboard_age_s = seconds_since(now_ns, self->offboard.last_received_ns),
        .ground_age_s = seconds_since(now_ns, inputs->ground_ns),
        .battery_age_s = seconds_since(now_ns, self->battery.time_ns),
        .battery_v = self->battery.voltage_v,
        .battery_remaining = self->battery.remaining,
        .tilt_rad = state->tilt_rad,
        .height_m = -state->position[2],
        .climb_m_s = -state->velocity[2],
        .distance_m = real_sqrt(north * north + east * east),
        .position_sigma_m = state->position_sigma_m,
        .thrust_to_weight = self->actuators.delivered.thrust_n / (self->airframe.mass_kg * GRAVITY),
        .initialised = state->initialised,
        .preflight = is_in(self->mode, MODES_AIRBORNE) ? 0 : inputs->preflight,
        .calibration = (int32_t)self->estimator.calibration.refusal,
        .fault = !estimator_healthy(&self->estimator),
        .gyro_stuck = stuck_gyro_any(&self->estimator.gyro),
    };
}

/* OnboardCore._supervise: the flight mode from ages, limits and commands */
static FlightMode supervise(Core *self, const CoreInputs *inputs, CoreOutput *output) {
    const VehicleState *state = &self->estimator.state;
    SupervisorInputs seen;
    ArmingRefusal refusal;
    self->posed = self->posed || state->last_pose_ns != NEVER_NS;
    if (guidance_finished(&self->guidance) && !self->land_requested && self->mode == MODE_FLYING) {
        self->land_requested = true;
        supervisor_command(&self->supervisor, COMMAND_LAND, inputs->now_ns, &refusal);
    }
    supervisor_inputs(self, inputs, &seen);
    FlightMode mode = supervisor_step(&self->supervisor, &seen);
    output->supervisor_event_count = supervisor_take_events(&self->supervisor, output->supervisor_events);
    if (mode == MODE_TAKE_OFF && self->mode != MODE_TAKE_OFF) {
        guidance_start(&self->guidance, state);
        self->land_requested = false;
        self->stood_at_d = state->position[2];
    }
    estimator_set_on_ground(&self->estimator, !is_in(mode, MODES_AIRBORNE), is_in(mode, MODES_RESTING));
    self->mode = mode;
    return mode;
}

/* OnboardCore._guide: the target of this tick */
static void guide(Core *self, FlightMode mode) {
    const VehicleState *state = &self->estimator.state;
    guidance_follow_jump(&self->guidance, state, self->posed);
    if (mode == MODE_LANDED) {
        guidance_rest(&self->guidance, state->position);
    }
    bool run = mode == MODE_TAKE_OFF || mode == MODE_FLYING;
    guidance_step(&self->guidance, run, mode == MODE_LANDING, self->whole_dt, mode == MODE_TAKE_OFF, &self->target);
    if (mode == MODE_HOLD_LEVEL) { /* the vehicle drifts: a landing that follows begins where the vehicle is then */
        guidance_place(&self->guidance, state->position);
    }
}

/* AdaptationGate.allows: whether what is measured now may be learnt from */
static bool may_adapt(const Core *self, FlightMode mode, int64_t now_ns) {
    const VehicleState *state = &self->estimator.state;
    bool aided = seconds_since(now_ns, state->last_velocity_aid_ns) < VELOCITY_AID_MAX_S;
    real down = state->position[2];
    bool clear = mode == MODE_TAKE_OFF ? self->stood_at_d - down > ADAPT_CLIMB_M : -down > ADAPT_HEIGHT_M;
    return is_in(mode, MODES_AIRBORNE) && clear && aided;
}

/* The actuator model, u_hat and the residual up to now; fills what the controller sees of them. */
static void measure(Core *self, int32_t missed, ControlInputs *inputs) {
    const VehicleState *state = &self->estimator.state;
    ActuatorModel *actuators = &self->actuators;
    Delivered passed[1 + CATCH_UP_MAX], ahead;
    actuators_set_scale(actuators, self->thrust_scale.value);
    self->mixer.scale = self->thrust_scale.value;
    int32_t periods = actuators_catch_up(actuators, self->command, missed, passed);
    uncertainty_step(&self->uncertainty, state, passed, periods);
    const ChannelMeasurement *attitude = &self->uncertainty.attitude;
    estimator_expect_turn(&self->estimator, attitude->u_hat, attitude->residual, self->dt);
    actuators_ahead(actuators, self->command, &ahead);
    uncertainty_coming(&self->uncertainty, state, &actuators->delivered, &ahead, inputs->coming_now,
                       inputs->coming_next);
    signal_vector_step(&self->signals, state, actuators->delivered.thrusts_n, self->battery.voltage_v);
    inputs->thrust_n = actuators->delivered.thrust_n;
    inputs->thrust_scale = actuators->scale;
}

/* OnboardCore._control: on the ground the controller and the thrust scale are held at their start */
static void control(Core *self, const ControlInputs *inputs, FlightMode mode) {
    if (!is_in(mode, MODES_AIRBORNE)) {
        cascade_reset(&self->controller, inputs);
        thrust_scale_reset(&self->thrust_scale);
    }
    cascade_step(&self->controller, inputs);
}

/* OnboardCore._mix: motor commands as shares of the maximum thrust, within limits and with motor lag compensated */
static void mix(Core *self, FlightMode mode) {
    const ControlOutput *demand = &self->controller.output;
    real wanted[4];
    self->saturated = false;
    if (is_in(mode, MODES_AIRBORNE)) {
        mixer_thrusts(&self->mixer, demand->thrust_n, demand->torque_nm, wanted);
        self->saturated = mixer_falls_short(&self->mixer, wanted, demand->thrust_n, demand->torque_nm);
        actuators_overdriven(&self->actuators, wanted, self->command);
        return;
    }
    real idle = mode == MODE_ARMED ? self->airframe.motor_thrust_min_share : REAL(0.0);
    for (int i = 0; i < 4; i++) {
        self->command[i] = idle;
    }
}

/* OnboardCore._sample: samples for the trainer, from flight only, as datagrams when a batch is due */
static void sample(Core *self, const ControlInputs *control_inputs, int64_t now_ns, CoreOutput *output) {
    OffboardLink *link = &self->offboard;
    if (control_inputs->adapt) {
        real u_hat[CHANNEL_VALUES], nu_ad[CHANNEL_VALUES];
        vector_copy(self->uncertainty.position.u_hat, u_hat);
        vector_copy(self->uncertainty.attitude.u_hat, u_hat + 3);
        vector_copy(self->controller.output.position.adaptive_now, nu_ad);
        vector_copy(self->controller.output.attitude.adaptive_now, nu_ad + 3);
        sampler_push(&self->samples, now_ns, self->signals.values, u_hat, nu_ad);
    }
    SampleBatch *batches = self->batches;
    int32_t due =
        sampler_poll(&self->samples, now_ns, self->reception.version, offboard_link_loss_share(link, now_ns), batches);
    output->to_offboard_count = 0;
    for (int32_t i = 0; i < due; i++) {
        output->to_offboard_count +=
            offboard_link_batch(link, batches + i, now_ns, output->to_offboard + output->to_offboard_count);
    }
}

/* OffboardLink.status of this vehicle, if it is due; whether it was written */
static bool say_status(Core *self, int64_t now_ns, Datagram *out) {
    ReceptionStatus reception;
    if (!offboard_link_status_due(&self->offboard, now_ns)) {
        return false;
    }
    reception_status(&self->reception, &reception);
    Status status = {
        .mode = (int64_t)self->mode,
        .feature_version = reception.version,
        .transfer_version = reception.transfer_version,
        .received_chunks_size = reception.received_chunks_size,
        .refused_version = reception.refused_version,
        .refusal = (int64_t)reception.refusal,
        .ticks = self->ticks,
        .missed_ticks = self->missed_ticks,
    };
    memcpy(status.received_chunks, reception.received_chunks, sizeof reception.received_chunks);
    reception_note_status(&self->reception);
    return offboard_link_status(&self->offboard, &status, self->estimator.state.last_pose_ns, now_ns, out);
}

/* OnboardCore._report, to offboard: time sync and status, each at its own period */
static void report(Core *self, int64_t now_ns, CoreOutput *output) {
    int32_t batches = output->to_offboard_count;
    Datagram *small = output->to_offboard + batches;
    int32_t count = offboard_link_time_sync(&self->offboard, now_ns, small);
    output->has_clock = offboard_link_clock_record(&self->offboard, now_ns, &output->clock);
    output->status_sent = say_status(self, now_ns, small + count);
    count += output->status_sent;
    for (int32_t i = 0; i < count; i++) {
        sampler_charge(&self->samples, small[i].size, now_ns);
    }
    output->to_offboard_count = batches + count;
}

static void record(const Core *self, const ControlInputs *control_inputs, int64_t now_ns, CoreOutput *output) {
    TickContext context = {
        .mode = self->mode,
        .saturated = self->saturated,
        .path_time_s = self->guidance.clock.time_s,
        .feature_version = self->reception.version,
        .feature_age_s = reception_age_s(&self->reception, now_ns),
        .pose_age_s = age_s(now_ns, self->estimator.state.last_pose_ns),
        .offboard_age_s = age_s(now_ns, self->offboard.last_received_ns),
        .battery_v = self->battery.voltage_v,
        .motors = self->command,
        .motor_thrusts_n = self->actuators.delivered.thrusts_n,
    };
    write_tick(output->tick, control_inputs, &self->controller.output, &context);
}

/* OnboardCore.tick */
void core_tick(Core *self, const CoreInputs *inputs, CoreOutput *output) {
    const VehicleState *state = &self->estimator.state;
    int64_t now_ns = inputs->now_ns, skipped = inputs->missed_ticks - self->missed_ticks;
    int32_t missed = (int32_t)(skipped < CATCH_UP_MAX ? skipped : CATCH_UP_MAX);
    self->missed_ticks = inputs->missed_ticks;
    self->dt = (real)(1 + missed) * self->period_s;
    self->whole_dt = (double)(1 + missed) * self->whole_period_s;
    output->link_event_count = offboard_link_take_events(&self->offboard, output->link_events);
    output->estimator_event_count = estimator_take_events(&self->estimator, output->estimator_events);
    FlightMode mode = supervise(self, inputs, output);
    guide(self, mode);
    ControlInputs control_inputs = {
        .dt = self->dt,
        .state = state,
        .target = &self->target,
        .signals = self->signals.values,
        .position = &self->uncertainty.position,
        .attitude = &self->uncertainty.attitude,
        .saturated = self->saturated,
        .adapt = may_adapt(self, mode, now_ns),
        .level_only = mode == MODE_HOLD_LEVEL,
        .busy = inputs->spare != SPARE_ALL,
        .missed = missed,
    };
    measure(self, missed, &control_inputs);
    thrust_scale_step(&self->thrust_scale, state->specific_force[2], control_inputs.thrust_n, control_inputs.adapt);
    reception_swap(&self->reception, &self->controller, now_ns, inputs->spare, &output->features);
    control(self, &control_inputs, mode);
    mix(self, mode);
    memcpy(output->motors, self->command, sizeof output->motors);
    output->spinning = is_in(mode, MODES_SPINNING);
    output->mode = mode;
    sample(self, &control_inputs, now_ns, output);
    report(self, now_ns, output);
    record(self, &control_inputs, now_ns, output);
    real off[3];
    vector_subtract(state->position, self->target.path.position, off);
    self->tracking_error_m = vector_length(off);
    self->ticks++;
}
