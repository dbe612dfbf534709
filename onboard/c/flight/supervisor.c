#include "flight/supervisor.h"

#include <math.h>
#include <string.h>

#include "numerics/elementary.h"
#include "numerics/whole.h"

#define NO_COMMAND (-1)
#define DESCENDING ((1 << MODE_HOLD_LEVEL) | (1 << MODE_LANDING))

/* Supervisor.__init__ */
void supervisor_init(Supervisor *self, const SupervisorConfig *config) {
    memset(self, 0, sizeof *self);
    self->config = *config;
    self->mode = MODE_BOOT;
    self->lowest_m = REAL(HUGE_VAL);
    self->offboard_silent = true;
    self->command = NO_COMMAND;
    for (int i = 0; i < EVENT_COUNT; i++) {
        self->since_ns[i] = NEVER_NS;
    }
}

static SupervisorEvent *new_event(Supervisor *self, SupervisorEventKind kind, int64_t time_ns) {
    if (self->event_count == SUPERVISOR_EVENTS_MAX) {
        self->events_lost++;
        self->event_count--;
    }
    SupervisorEvent *event = self->events + self->event_count++;
    memset(event, 0, sizeof *event);
    event->kind = kind;
    event->time_ns = time_ns;
    return event;
}

/* Supervisor.take_events */
int32_t supervisor_take_events(Supervisor *self, SupervisorEvent *events) {
    int32_t count = self->event_count;
    memcpy(events, self->events, (size_t)count * sizeof *events);
    self->event_count = 0;
    return count;
}

static ArmingRefusal refused(ArmingReason reason, int32_t number, real value, real limit) {
    return (ArmingRefusal){reason, number, value, limit};
}

static ArmingRefusal refused_for(ArmingReason reason) {
    return refused(reason, 0, REAL(0.0), REAL(0.0));
}

/* Supervisor._sensor_refusal: the first reason but the calibration */
static ArmingRefusal sensor_refusal(const Supervisor *self, const SupervisorInputs *i) {
    const SupervisorConfig *config = &self->config;
    real v = i->battery_v;
    if (i->preflight != 0) { /* first, because a fault of the link explains the other reasons */
        return refused(ARMING_PREFLIGHT, i->preflight, REAL(0.0), REAL(0.0));
    }
    if (!i->initialised || i->imu_age_s > config->imu_silent_s) {
        return refused_for(ARMING_NO_ATTITUDE);
    }
    if (config->arm_needs_pose && i->pose_age_s > config->pose_stale_s) {
        return refused_for(ARMING_NO_POSE);
    }
    if (i->tilt_rad > LEVEL_MAX_RAD) {
        return refused_for(ARMING_NOT_LEVEL);
    }
    if (v > REAL(0.0) && v < config->battery_arm_v) {
        return refused(ARMING_BATTERY_LOW, 0, v, config->battery_arm_v);
    }
    if (v > config->battery_max_v) {
        return refused(ARMING_BATTERY_HIGH, 0, v, config->battery_max_v);
    }
    if (REAL(0.0) <= i->battery_remaining && i->battery_remaining < config->battery_low_remaining) {
        return refused(ARMING_BATTERY_EMPTY, 0, i->battery_remaining, config->battery_low_remaining);
    }
    if (config->battery_silent_s > REAL(0.0) && v <= REAL(0.0)) {
        return refused_for(ARMING_NO_BATTERY);
    }
    if (REAL(0.0) < config->battery_silent_s && config->battery_silent_s < i->battery_age_s) {
        return refused_for(ARMING_BATTERY_OLD);
    }
    if (REAL(0.0) < config->ground_silent_s && config->ground_silent_s < i->ground_age_s) {
        return refused_for(ARMING_NO_GROUND);
    }
    if (i->distance_m > config->fence_m) {
        return refused(ARMING_FENCE, 0, i->distance_m, config->fence_m);
    }
    return refused_for(ARMING_ALLOWED);
}

/* Supervisor.arming_refusal */
void supervisor_arming_refusal(const Supervisor *self, const SupervisorInputs *inputs, ArmingRefusal *refusal) {
    *refusal = sensor_refusal(self, inputs);
    if (refusal->reason == ARMING_ALLOWED && inputs->calibration != 0) {
        *refusal = refused(ARMING_CALIBRATION, inputs->calibration, REAL(0.0), REAL(0.0));
    }
}

static bool may_arm(const Supervisor *self, const SupervisorInputs *inputs) {
    ArmingRefusal refusal;
    supervisor_arming_refusal(self, inputs, &refusal);
    return refusal.reason == ARMING_ALLOWED;
}

/* COMMAND_EVENTS */
static Event event_of(Command command) {
    static const Event events[] = {[COMMAND_ARM] = EVENT_ARM,
                                   [COMMAND_DISARM] = EVENT_DISARM,
                                   [COMMAND_TAKE_OFF] = EVENT_TAKE_OFF,
                                   [COMMAND_LAND] = EVENT_LAND,
                                   [COMMAND_TERMINATE] = EVENT_TERMINATE};
    return events[command];
}

static bool has_event(FlightMode mode, Event event) {
    Transition entry;
    for (int32_t i = 0; transition(mode, i, &entry); i++) {
        if (entry.event == event) {
            return true;
        }
    }
    return false;
}

/* Supervisor._refusal */
static ArmingRefusal command_refusal(const Supervisor *self, Command command) {
    ArmingRefusal arming = refused_for(ARMING_ALLOWED);
    if (command == COMMAND_ARM) {
        arming.reason = ARMING_NOT_RUNNING;
        if (self->has_inputs) {
            supervisor_arming_refusal(self, &self->inputs, &arming);
        }
        if (self->mode == MODE_BOOT && self->has_inputs && arming.reason != ARMING_ALLOWED) {
            return arming;
        }
    }
    if (!has_event(self->mode, event_of(command))) {
        return refused(ARMING_OTHER_MODE, (int32_t)self->mode, REAL(0.0), REAL(0.0));
    }
    return arming;
}

/* Supervisor.command */
void supervisor_command(Supervisor *self, Command command, int64_t now_ns, ArmingRefusal *refusal) {
    *refusal = command_refusal(self, command);
    if (refusal->reason != ARMING_ALLOWED) {
        SupervisorEvent *event = new_event(self, SUPERVISOR_REFUSED, now_ns);
        event->command = command;
        event->refusal = *refusal;
        return;
    }
    if (self->queue_count == COMMAND_QUEUE_MAX) { /* the oldest is lost */
        self->queue_count--;
        memmove(self->queue, self->queue + 1, (size_t)self->queue_count * sizeof self->queue[0]);
    }
    self->queue[self->queue_count++] = command;
}

/* Supervisor._next_command: termination goes before all others */
static int32_t next_command(Supervisor *self) {
    if (self->queue_count == 0) {
        return NO_COMMAND;
    }
    for (int32_t i = 0; i < self->queue_count; i++) {
        if (self->queue[i] == COMMAND_TERMINATE) {
            self->queue_count = 0;
            return COMMAND_TERMINATE;
        }
    }
    int32_t command = (int32_t)self->queue[0];
    self->queue_count--;
    memmove(self->queue, self->queue + 1, (size_t)self->queue_count * sizeof self->queue[0]);
    return command;
}

/* Supervisor._position_lost */
static bool position_lost(const SupervisorConfig *config, const SupervisorInputs *i) {
    if (i->pose_age_s <= config->pose_stale_s) {
        return false;
    }
    if (config->on_pose_stale == SUPERVISOR_ON_POSE_STALE_HOLD) {
        return true;
    }
    bool carried = i->velocity_aid_age_s <= config->velocity_stale_s;
    return !carried || i->position_sigma_m > config->position_sigma_max_m;
}

/* Supervisor._battery_low */
static bool battery_low(const SupervisorConfig *config, const SupervisorInputs *i) {
    return (REAL(0.0) < i->battery_v && i->battery_v < config->battery_low_v) ||
           (REAL(0.0) <= i->battery_remaining && i->battery_remaining < config->battery_low_remaining);
}

/* Supervisor._touched_down: not moving, and either low or with little thrust: neither can last in the air */
static bool touched_down(const SupervisorConfig *config, const SupervisorInputs *i) {
    if (real_abs(i->climb_m_s) > config->touch_down_speed_m_s) {
        return false;
    }
    return i->height_m < config->touch_down_height_m || i->thrust_to_weight < config->touch_down_thrust;
}

/* self._time_limit_ns */
static int64_t time_limit_ns(const Supervisor *self) {
    const SupervisorConfig *config = &self->config;
    switch (self->mode) {
        case MODE_ARMED:
            return nanoseconds_below(config->armed_max_s);
        case MODE_TAKE_OFF:
            return nanoseconds_below(config->take_off_max_s);
        case MODE_HOLD:
            return nanoseconds_below(config->hold_max_s);
        case MODE_HOLD_LEVEL:
            return nanoseconds_below(config->level_max_s);
        case MODE_LANDING:
            return nanoseconds_below(config->landing_max_s);
        default:
            return nanoseconds_below(config->landed_s);
    }
}

/* _CONDITIONS of what a pilot or the flight plan asks for */
static bool is_asked(const Supervisor *self, Event event, const SupervisorInputs *i) {
    bool alone = self->config.auto_arm && !self->flown;
    switch (event) {
        case EVENT_TERMINATE:
            return self->command == COMMAND_TERMINATE;
        case EVENT_ARM:
            return (alone || self->command == COMMAND_ARM) && may_arm(self, i);
        case EVENT_DISARM:
            return self->command == COMMAND_DISARM;
        case EVENT_TAKE_OFF:
            return alone || self->command == COMMAND_TAKE_OFF;
        default:
            return self->command == COMMAND_LAND;
    }
}

/* _CONDITIONS */
static bool is_true(const Supervisor *self, Event event, const SupervisorInputs *i) {
    const SupervisorConfig *config = &self->config;
    bool imu_silent = i->imu_age_s > config->imu_silent_s;
    switch (event) {
        case EVENT_IMU_SILENT_LANDED:
            return imu_silent && i->height_m < config->touch_down_height_m;
        case EVENT_IMU_SILENT:
            return imu_silent;
        case EVENT_FAULT:
            return i->fault;
        case EVENT_TILTED:
            return !(i->tilt_rad <= config->tilt_max_rad);
        case EVENT_VELOCITY_LOST:
            return i->velocity_aid_age_s > config->velocity_lost_s;
        case EVENT_VELOCITY_BACK:
            return i->velocity_aid_age_s <= config->velocity_stale_s;
        case EVENT_POSITION_LOST:
            return position_lost(config, i);
        case EVENT_POSITION_BACK:
            return !position_lost(config, i);
        case EVENT_GYRO_STUCK:
            return i->gyro_stuck;
        case EVENT_BATTERY_LOW:
            return battery_low(config, i);
        case EVENT_BATTERY_SILENT:
            return REAL(0.0) < config->battery_silent_s && config->battery_silent_s < i->battery_age_s;
        case EVENT_GROUND_SILENT:
            return REAL(0.0) < config->ground_silent_s && config->ground_silent_s < i->ground_age_s;
        case EVENT_OUT_OF_BOUNDS:
            return i->distance_m > config->fence_m || i->height_m > config->ceiling_m;
        case EVENT_TIME_UP:
            return i->now_ns - self->timed_from_ns >= time_limit_ns(self);
        case EVENT_TOUCHED_DOWN:
            return touched_down(config, i);
        case EVENT_AT_HEIGHT:
            return i->height_m >= config->take_off_height_m - config->take_off_tolerance_m;
        case EVENT_HEALTHY:
            return sensor_refusal(self, i).reason == ARMING_ALLOWED;
        case EVENT_UNHEALTHY: /* _sensors_lost */
            return !i->initialised || imu_silent || i->preflight != 0 || i->calibration != 0;
        default:
            return is_asked(self, event, i);
    }
}

/* self._lasting_ns; -1: the condition decides at once */
static int64_t lasting_ns(const SupervisorConfig *config, Event event) {
    switch (event) {
        case EVENT_HEALTHY:
            return nanoseconds_below(config->healthy_for_s);
        case EVENT_POSITION_BACK:
        case EVENT_VELOCITY_BACK:
            return nanoseconds_below(config->back_for_s);
        case EVENT_TOUCHED_DOWN:
            return nanoseconds_below(config->touch_down_for_s);
        case EVENT_BATTERY_LOW:
            return nanoseconds_below(config->battery_low_for_s);
        default:
            return -1;
    }
}

/* Supervisor._has_lasted: whether the condition has been true long enough. The calibration runs meanwhile. */
static bool has_lasted(Supervisor *self, Event event, const SupervisorInputs *inputs) {
    int64_t lasting = lasting_ns(&self->config, event);
    if (lasting < 0) {
        return true;
    }
    int64_t *since_ns = self->since_ns + event;
    if (*since_ns == NEVER_NS) {
        *since_ns = inputs->now_ns;
    }
    bool lasted = inputs->now_ns - *since_ns >= lasting;
    return lasted && !(event == EVENT_HEALTHY && inputs->calibration != 0);
}

/* Supervisor._enter */
static void enter(Supervisor *self, FlightMode mode, Event event, const SupervisorInputs *inputs) {
    SupervisorEvent *entered = new_event(self, SUPERVISOR_ENTERED, inputs->now_ns);
    entered->from = self->mode;
    entered->to = mode;
    entered->event = event;
    if (event == EVENT_UNHEALTHY) {
        supervisor_arming_refusal(self, inputs, &entered->refusal);
    }
    self->mode = mode;
    self->timed_from_ns = inputs->now_ns;
    self->lowest_m = inputs->height_m;
    for (int i = 0; i < EVENT_COUNT; i++) {
        self->since_ns[i] = NEVER_NS;
    }
    self->not_ready = ARMING_ALLOWED;
    self->flown = self->flown || mode == MODE_TAKE_OFF;
}

/* Supervisor._report_offboard */
static void report_offboard(Supervisor *self, const SupervisorInputs *inputs) {
    bool silent = inputs->offboard_age_s > self->config.offboard_silent_s;
    if (silent != self->offboard_silent) {
        self->offboard_silent = silent;
        new_event(self, silent ? SUPERVISOR_SILENT : SUPERVISOR_CONNECTED, inputs->now_ns);
    }
}

/* Supervisor._report_readiness: each reason once (its values apart), after it has lasted */
static void report_readiness(Supervisor *self, const SupervisorInputs *inputs) {
    ArmingRefusal refusal;
    supervisor_arming_refusal(self, inputs, &refusal);
    if (refusal.reason != self->not_ready || refusal.number != self->not_ready_number) {
        self->not_ready = refusal.reason;
        self->not_ready_number = refusal.number;
        self->not_ready_since_ns = inputs->now_ns;
        self->not_ready_reported = false;
    }
    bool lasted = inputs->now_ns - self->not_ready_since_ns >= NOT_READY_NS;
    if (refusal.reason != ARMING_ALLOWED && !self->not_ready_reported && lasted) {
        self->not_ready_reported = true;
        new_event(self, SUPERVISOR_NOT_READY, inputs->now_ns)->refusal = refusal;
    }
}

/* Supervisor._note_progress: the time limit starts again when the descent has got lower. Below the floor nothing counts. */
static void note_progress(Supervisor *self, const SupervisorInputs *inputs) {
    if (REAL(0.0) < inputs->height_m && inputs->height_m < self->lowest_m - PROGRESS_M) {
        self->lowest_m = inputs->height_m;
        self->timed_from_ns = inputs->now_ns;
    }
}

/* Supervisor.step */
FlightMode supervisor_step(Supervisor *self, const SupervisorInputs *inputs) {
    if (!self->timed) {
        self->timed = true;
        self->timed_from_ns = inputs->now_ns;
    }
    if ((1 << self->mode) & DESCENDING) {
        note_progress(self, inputs);
    }
    self->inputs = *inputs;
    self->has_inputs = true;
    self->command = next_command(self);
    Transition entry;
    for (int32_t i = 0; transition(self->mode, i, &entry); i++) {
        if (!is_true(self, entry.event, inputs)) {
            self->since_ns[entry.event] = NEVER_NS;
        } else if (has_lasted(self, entry.event, inputs)) {
            enter(self, entry.target, entry.event, inputs);
            break;
        }
    }
    report_offboard(self, inputs);
    if (self->mode == MODE_BOOT) {
        report_readiness(self, inputs);
    }
    return self->mode;
}
