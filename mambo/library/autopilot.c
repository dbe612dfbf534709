#include "autopilot.h"

#include <string.h>

#include "numerics/elementary.h"

bool autopilot_init(Autopilot *self, const Image *image, uint64_t session) {
    const LibraryConfig *settings = &image->settings;
    const BoardConfig *board = &settings->board;
    memset(self, 0, sizeof *self);
    sensor_reader_init(&self->reader, settings, image->core.period_ns);
    call_watch_init(&self->calls, &board->watchdogs, image->core.period_ns);
    arming_checks_init(&self->arming, &settings->arming);
    motors_init(&self->motors, &board->motors);
    self->heed_stop = board->watchdogs.heed_stop;
    self->features_in_flight = board->link.features_in_flight;
    self->last_ns = self->ground_ns = NEVER_NS;
    self->battery = (BatteryReading){NEVER_NS, REAL(0.0), REAL(-1.0)};
    self->mode = MODE_BOOT;
    return core_init(&self->core, &image->core, image->start, session, image->key, image->key_size);
}

static bool flies(const Autopilot *self) {
    return (UINT32_C(1) << self->core.mode & MODES_SPINNING) != 0;
}

/* End the flight at once: motors off. */
static void terminate(Autopilot *self, const char *why, int64_t now_ns) {
    ArmingRefusal refusal;
    if (self->ended == CHECK_PASSED) {
        events_add(&self->events, now_ns, "motors off: %s", why);
        self->ended = CHECK_STOPPED;
    }
    core_command(&self->core, COMMAND_TERMINATE, now_ns, &refusal);
}

/* Land, or disarm a vehicle that has not taken off. */
static void land(Autopilot *self, const char *why, int64_t now_ns) {
    FlightMode mode = self->core.mode;
    ArmingRefusal refusal;
    if (mode == MODE_ARMED) {
        events_add(&self->events, now_ns, "disarmed: %s", why);
        core_command(&self->core, COMMAND_DISARM, now_ns, &refusal);
    } else if (mode == MODE_TAKE_OFF || mode == MODE_FLYING || mode == MODE_HOLD) {
        events_add(&self->events, now_ns, "landing: %s", why);
        core_command(&self->core, COMMAND_LAND, now_ns, &refusal);
    }
}

/* --- a call begins --- */

/* The bound of a channel's slope; NULL for a law without one. */
static SlopeBound *slope_bound_of(Autopilot *self, int channel) {
    Augmentation *law = self->core.controller.augmentations + channel;
    bool bounds = law->kind == AUGMENTATION_ADAPTIVE && law->adaptive.config.law.kind == LAW_KALMAN;
    return bounds && law->adaptive.slope_bound.count > 0 ? &law->adaptive.slope_bound : NULL;
}

/* Spread the work over the calls: the two channels bound their slopes in different ones. */
static void spread(Autopilot *self) {
    SlopeBound *position = slope_bound_of(self, 0), *attitude = slope_bound_of(self, 1);
    if (position && attitude && position->ticks == attitude->ticks) {
        attitude->ticks = (attitude->ticks + SLOPE_PERIOD_TICKS / 2) % SLOPE_PERIOD_TICKS;
    }
}

bool autopilot_begin(Autopilot *self, const HalCommand *command, int64_t now_ns) {
    CallVerdict verdict = call_watch_begin(&self->calls, now_ns);
    if (verdict == CALL_TWICE) {
        return false;
    }
    spread(self);
    if (self->heed_stop && self->motors.running && command->command == MOTORS_STOP) {
        terminate(self, "the firmware stopped them", now_ns);
    }
    if (!flies(self)) {
        return true;
    }
    if (verdict == CALL_TOO_LATE) {
        terminate(self, "the firmware called far too late", now_ns);
    } else if (verdict == CALL_LATE) {
        land(self, "the firmware called late", now_ns);
    } else if (call_watch_wrong_rate(&self->calls)) {
        land(self, "the firmware calls at a wrong rate", now_ns);
    }
    return true;
}

/* --- what comes --- */

static FlowGeometry flow_geometry(const Autopilot *self) {
    const VehicleState *state = &self->core.estimator.state;
    FlowGeometry geometry = {.known = state->initialised && state->rotation[8] > REAL(0.1)};
    if (geometry.known) {
        geometry.distance_m = -state->position[2] / state->rotation[8];
        memcpy(geometry.gyro_bias, state->gyro_bias, sizeof geometry.gyro_bias);
    }
    return geometry;
}

void autopilot_receive_sensors(Autopilot *self, const uint8_t *acquisition, const FlowCall *calls, int32_t call_count,
                               int64_t now_ns) {
    FlowGeometry geometry = flow_geometry(self);
    Readings readings;
    sensor_reader_read(&self->reader, acquisition, calls, call_count, &geometry, now_ns, &readings);
    if (readings.has_imu) {
        arming_checks_note_imu(&self->arming, &readings.imu);
        core_receive_imu(&self->core, &readings.imu);
    }
    if (call_count > 0) {
        arming_checks_note_flow(&self->arming, now_ns);
        self->received = true;
    }
    for (int32_t i = 0; i < readings.flow_count; i++) {
        core_receive_flow(&self->core, readings.flows + i);
    }
    if (readings.has_range) {
        core_receive_range(&self->core, &readings.range);
    }
    if (readings.has_battery) {
        self->battery = readings.battery;
        core_receive_battery(&self->core, &readings.battery);
    }
    bool frozen = sensor_reader_is_frozen(&self->reader);
    if (frozen && !self->frozen) {
        events_add(&self->events, now_ns, "the acquisition repeats: sensors frozen");
    }
    self->frozen = frozen;
}

bool autopilot_receive_offboard(Autopilot *self, const uint8_t *datagram, size_t size, int64_t now_ns) {
    BudgetStage stage = self->calls.stage;
    bool no_features = stage == BUDGET_NO_TRAINING || (flies(self) && !self->features_in_flight);
    if (stage >= BUDGET_NO_OFFBOARD || (no_features && size > SHORT_DATAGRAM_BYTES)) {
        self->datagrams_left_out++;
        return false;
    }
    Received received;
    core_receive_offboard(&self->core, datagram, size, now_ns, &received);
    if (received.has_pose) {
        arming_checks_note_pose(&self->arming, &received.pose.pose, now_ns);
    }
    bool costly = received.has_pose || received.has_chunk;
    self->received = self->received || costly;
    return costly;
}

void autopilot_command(Autopilot *self, Command command, int64_t now_ns, ArmingRefusal *refusal) {
    core_command(&self->core, command, now_ns, refusal);
}

/* --- a step --- */

static ArmingCheck judge(Autopilot *self, int64_t now_ns) {
    bool posed = self->core.posed || self->core.estimator.state.last_pose_ns != NEVER_NS;
    ArmingCheck check = arming_checks_judge(&self->arming, &self->calls, posed, self->frozen, now_ns);
    check = self->ended != CHECK_PASSED ? self->ended : check;
    if (check != self->check && !flies(self)) {
        events_add(&self->events, now_ns, "before arming: %s", arming_check_text(check));
    }
    self->check = check;
    return check;
}

void autopilot_step(Autopilot *self, HalCommand *command, int64_t now_ns) {
    CoreInputs inputs = {
        .now_ns = now_ns,
        .missed_ticks = self->calls.missed,
        .preflight = (int32_t)judge(self, now_ns),
        .ground_ns = self->ground_ns,
        .spare = self->calls.stage >= BUDGET_NO_TRAINING ? SPARE_NONE
                 : self->received                        ? SPARE_LITTLE
                                                         : SPARE_ALL,
    };
    self->received = false;
    if (self->calls.stage == BUDGET_LAND && flies(self)) {
        land(self, "the library takes too long", now_ns);
    }
    core_tick(&self->core, &inputs, &self->output);
    self->mode = self->output.mode;
    motors_write(&self->motors, self->output.motors, self->output.spinning && self->ended == CHECK_PASSED, command);
}

const Datagram *autopilot_datagram(const Autopilot *self, int32_t index) {
    for (int32_t i = 0; i < self->output.to_offboard_count; i++) {
        const Datagram *one = self->output.to_offboard + i;
        bool left_out = self->calls.stage >= BUDGET_NO_TRAINING && one->size > SHORT_DATAGRAM_BYTES;
        if (!left_out && index-- == 0) {
            return one;
        }
    }
    return NULL;
}

void autopilot_end(Autopilot *self, int64_t end_ns) {
    static const char *const texts[] = {"everything again", "without training", "without offboard", "landing"};
    if (call_watch_end(&self->calls, end_ns)) {
        events_add(&self->events, end_ns, "calls take up to %ld us: %s", (long)(self->calls.longest_ns / 1000),
                   texts[self->calls.stage]);
    }
}
