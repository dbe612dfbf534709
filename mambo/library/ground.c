#include "ground.h"

#include <string.h>

#include "generated/modes.h"
#include "protocol/little_endian.h"

/* MAV_CMD, MAV_RESULT, MAV_MODE_FLAG and MAV_STATE of MAVLink's common dialect. */
enum { COMMAND_NAV_LAND = 21, COMMAND_NAV_TAKEOFF = 22, COMMAND_FLIGHTTERMINATION = 185, COMMAND_ARM_DISARM = 400 };
enum { RESULT_ACCEPTED = 0, RESULT_TEMPORARILY_REJECTED = 1, RESULT_UNSUPPORTED = 3 };
enum { FLAG_CUSTOM = 1, FLAG_STABILIZE = 16, FLAG_ARMED = 128 };
enum { STATE_CALIBRATING = 2, STATE_STANDBY = 3, STATE_ACTIVE = 4, STATE_CRITICAL = 5, STATE_EMERGENCY = 6 };
#define TYPE_QUADROTOR 2
#define AUTOPILOT_GENERIC 0
/* Second parameter that disarms in flight too. */
#define FORCE 21196.0f
#define SEVERITY_INFO 6
#define TEXT_BYTES 50
/* Sensors and controls that are shown: gyroscope, accelerometer, pressure, attitude, motors. */
#define PRESENT (UINT32_C(1) | 2 | 8 | 2048 | 32768)
#define UNKNOWN_MV 65535

static const int64_t PERIODS_NS[4] = {100000000, 100000000, 1000000000, 500000000};

void ground_init(GroundLink *self, const Image *image, int64_t wall_ns, int64_t now_ns) {
    memset(self, 0, sizeof *self);
    mavlink_init(&self->mavlink, image->ground_key, image->ground_key_size, wall_ns, now_ns);
}

static void write_u16(uint8_t *bytes, uint32_t value) {
    bytes[0] = (uint8_t)value;
    bytes[1] = (uint8_t)(value >> 8);
}

static void write_u32(uint8_t *bytes, uint32_t value) {
    write_u16(bytes, value);
    write_u16(bytes + 2, value >> 16);
}

/* --- receive --- */

/* The command that a MAV_CMD stands for; false if there is none. */
static bool meaning(uint32_t number, float first, float second, Command *out) {
    switch (number) {
        case COMMAND_ARM_DISARM:
            *out = first == 1.0f ? COMMAND_ARM : second == FORCE ? COMMAND_TERMINATE : COMMAND_DISARM;
            return first == 1.0f || first == 0.0f;
        case COMMAND_NAV_TAKEOFF:
            *out = COMMAND_TAKE_OFF;
            return true;
        case COMMAND_NAV_LAND:
            *out = COMMAND_LAND;
            return true;
        case COMMAND_FLIGHTTERMINATION:
            *out = COMMAND_TERMINATE;
            return first > 0.5f;
        default:
            return false;
    }
}

static void answer(GroundLink *self, const MavlinkFrame *frame, uint32_t number, uint8_t result) {
    memset(self->answer, 0, sizeof self->answer);
    write_u16(self->answer, number);
    self->answer[2] = result;
    self->answer[8] = frame->system;
    self->answer[9] = frame->component;
    self->has_answer = true;
}

void ground_receive(GroundLink *self, Autopilot *autopilot, const uint8_t *datagram, size_t size, int64_t now_ns) {
    MavlinkFrame frame;
    ArmingRefusal refusal = {.reason = ARMING_ALLOWED};
    Command command;
    if (!mavlink_read(&self->mavlink, datagram, size, now_ns, &frame)) {
        return;
    }
    autopilot->ground_ns = now_ns;
    uint8_t target = frame.payload[30];
    if (frame.message != MESSAGE_COMMAND_LONG || (target != 0 && target != 1)) {
        return;
    }
    uint32_t number = (uint32_t)frame.payload[28] | (uint32_t)frame.payload[29] << 8;
    if (!meaning(number, read_f32(frame.payload), read_f32(frame.payload + 4), &command)) {
        answer(self, &frame, number, RESULT_UNSUPPORTED);
        return;
    }
    autopilot_command(autopilot, command, now_ns, &refusal);
    bool refused = refusal.reason != ARMING_ALLOWED;
    answer(self, &frame, number, refused ? RESULT_TEMPORARILY_REJECTED : RESULT_ACCEPTED);
    if (refused) {
        events_add(&autopilot->events, now_ns, "refused: %s",
                   refusal.reason == ARMING_PREFLIGHT ? arming_check_text((ArmingCheck)refusal.number)
                                                      : "the supervisor does not allow it now");
    }
}

/* --- send --- */

static bool is_in(FlightMode mode, uint32_t modes) {
    return (UINT32_C(1) << mode & modes) != 0;
}

static uint8_t state_of(FlightMode mode) {
    switch (mode) {
        case MODE_BOOT:
            return STATE_CALIBRATING;
        case MODE_READY:
        case MODE_LANDED:
            return STATE_STANDBY;
        case MODE_HOLD:
            return STATE_CRITICAL;
        case MODE_HOLD_LEVEL:
        case MODE_EMERGENCY:
        case MODE_TERMINATED:
            return STATE_EMERGENCY;
        default:
            return STATE_ACTIVE;
    }
}

static size_t heartbeat(const Autopilot *autopilot, uint8_t *payload) {
    bool armed = is_in(autopilot->mode, MODES_SPINNING);
    write_u32(payload, (uint32_t)autopilot->mode);
    payload[4] = TYPE_QUADROTOR;
    payload[5] = AUTOPILOT_GENERIC;
    payload[6] = (uint8_t)(FLAG_CUSTOM | FLAG_STABILIZE | (armed ? FLAG_ARMED : 0));
    payload[7] = state_of(autopilot->mode);
    payload[8] = 3; /* version of MAVLink */
    return 9;
}

static size_t system_status(const Autopilot *autopilot, uint8_t *payload) {
    real voltage_v = autopilot->battery.voltage_v, remaining = autopilot->battery.remaining;
    uint32_t healthy = autopilot->frozen ? PRESENT & ~UINT32_C(3) : PRESENT;
    write_u32(payload, PRESENT);
    write_u32(payload + 4, PRESENT);
    write_u32(payload + 8, healthy);
    write_u16(payload + 14, voltage_v > REAL(0.0) ? (uint32_t)(REAL(1000.0) * voltage_v) : UNKNOWN_MV);
    write_u16(payload + 16, UNKNOWN_MV); /* current: -1, unknown */
    payload[30] = remaining >= REAL(0.0) ? (uint8_t)(REAL(100.0) * remaining) : 255;
    return 31;
}

static size_t floats(int64_t now_ns, const real *values, int32_t count, const real *more, int32_t more_count,
                     uint8_t *payload) {
    write_u32(payload, (uint32_t)(now_ns / 1000000));
    for (int32_t i = 0; i < count + more_count; i++) {
        write_f32(payload + 4 + 4 * i, (float)(i < count ? values[i] : more[i - count]));
    }
    return (size_t)(4 + 4 * (count + more_count));
}

static size_t periodic(int32_t index, const Autopilot *autopilot, int64_t now_ns, uint8_t *payload,
                       MavlinkMessage *message) {
    const VehicleState *state = &autopilot->core.estimator.state;
    switch (index) {
        case 0:
            *message = MESSAGE_ATTITUDE_QUATERNION;
            return floats(now_ns, state->quaternion, 4, state->rates, 3, payload);
        case 1:
            *message = MESSAGE_LOCAL_POSITION;
            return floats(now_ns, state->position, 3, state->velocity, 3, payload);
        case 2:
            *message = MESSAGE_HEARTBEAT;
            return heartbeat(autopilot, payload);
        default:
            *message = MESSAGE_SYS_STATUS;
            return system_status(autopilot, payload);
    }
}

/* STATUSTEXT of the next piece of an event's text; 0 if none waits. A text longer than a piece has a number. */
static size_t text_chunk(GroundLink *self, const Autopilot *autopilot, uint8_t *payload) {
    if (self->text_at == 0) {
        if (!events_copy(&autopilot->events, &self->read_events, &self->event)) {
            return 0;
        }
        self->text_id = self->text_id % 0xffff + 1;
    }
    size_t length = strlen(self->event.text), left = length - self->text_at;
    size_t part = left < TEXT_BYTES ? left : TEXT_BYTES;
    payload[0] = SEVERITY_INFO;
    memcpy(payload + 1, self->event.text + self->text_at, part);
    if (length > TEXT_BYTES) {
        write_u16(payload + 1 + TEXT_BYTES, self->text_id);
        payload[3 + TEXT_BYTES] = (uint8_t)(self->text_at / TEXT_BYTES);
    }
    self->text_at = left > TEXT_BYTES ? self->text_at + TEXT_BYTES : 0;
    return 4 + TEXT_BYTES;
}

size_t ground_poll(GroundLink *self, const Autopilot *autopilot, int64_t now_ns, uint8_t out[MAVLINK_FRAME_MAX]) {
    uint8_t payload[MAVLINK_PAYLOAD_MAX] = {0};
    MavlinkMessage message;
    int32_t next = 0;
    if (self->has_answer) {
        self->has_answer = false;
        return mavlink_write(&self->mavlink, MESSAGE_COMMAND_ACK, self->answer, sizeof self->answer, now_ns, out);
    }
    size_t text_size = text_chunk(self, autopilot, payload);
    if (text_size > 0) {
        return mavlink_write(&self->mavlink, MESSAGE_STATUSTEXT, payload, text_size, now_ns, out);
    }
    for (int32_t i = 0; i < 4; i++) {
        self->due_ns[i] = self->started ? self->due_ns[i] : now_ns;
        next = self->due_ns[i] < self->due_ns[next] ? i : next;
    }
    self->started = true;
    if (now_ns < self->due_ns[next]) {
        return 0;
    }
    int64_t late_ns = now_ns - self->due_ns[next];
    self->due_ns[next] = (late_ns > PERIODS_NS[next] ? now_ns : self->due_ns[next]) + PERIODS_NS[next];
    size_t size = periodic(next, autopilot, now_ns, payload, &message);
    return mavlink_write(&self->mavlink, message, payload, size, now_ns, out);
}
