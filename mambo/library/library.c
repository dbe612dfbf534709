#include "library.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "clock.h"
#include "session.h"

#define PATH_BYTES 256

static void path_of(const char *name, char path[PATH_BYTES]) {
    const char *folder = getenv(FOLDER_VARIABLE);
    snprintf(path, PATH_BYTES, "%s/%s", folder && folder[0] ? folder : DMRAC_FOLDER, name);
}

/* --- start --- */

static void write_log(const char *text) {
    char path[PATH_BYTES];
    path_of(LOG_FILE, path);
    FILE *file = fopen(path, "a");
    if (file) {
        fprintf(file, "%s\n", text);
        fclose(file);
    }
}

static void refuse(Library *self) {
    self->state = LIBRARY_REFUSED;
    write_log(self->fault.text);
}

static bool load_image(Library *self) {
    char path[PATH_BYTES];
    path_of(IMAGE_FILE, path);
    FILE *file = fopen(path, "rb");
    if (!file) {
        snprintf(self->fault.text, sizeof self->fault.text, "%.100s cannot be read", path);
        return false;
    }
    size_t size = fread(self->bytes, 1, sizeof self->bytes, file);
    fclose(file);
    return image_read(self->bytes, size, &self->image, &self->fault);
}

/* Without a key anybody on the radio could fly the vehicle. */
static bool has_key_or_needs_none(Library *self) {
    if (self->image.key_size > 0 || self->image.settings.board.link.offboard[0] == 127) {
        return true;
    }
    snprintf(self->fault.text, sizeof self->fault.text, "key: the link to another machine needs one");
    return false;
}

static bool open_link(Library *self) {
    const BoardLink *link = &self->image.settings.board.link;
    if (udp_open(&self->offboard, link->own_port, link->offboard, link->offboard_port)) {
        return true;
    }
    snprintf(self->fault.text, sizeof self->fault.text, "board.link.own_port %ld is taken", (long)link->own_port);
    return false;
}

static bool start_autopilot(Library *self) {
    char path[PATH_BYTES];
    path_of(SESSION_FILE, path);
    if (autopilot_init(&self->autopilot, &self->image, next_session(path, dmrac_wall_clock_ns()))) {
        return true;
    }
    snprintf(self->fault.text, sizeof self->fault.text, "key: %ld bytes are not allowed", (long)self->image.key_size);
    return false;
}

void library_start(Library *self, int64_t now_ns) {
    char path[PATH_BYTES];
    self->recorder.descriptor = self->offboard.descriptor = -1;
    if (!load_image(self) || !has_key_or_needs_none(self) || !start_autopilot(self)) {
        refuse(self);
        return;
    }
    self->mode = self->image.settings.board.mode;
    if (self->mode == BOARD_MODE_FLY && !open_link(self)) {
        refuse(self);
        return;
    }
    bench_init(&self->bench, &self->image.settings.board.record);
    path_of(RECORD_FILE, path);
    recorder_open(&self->recorder, path, &self->image.settings.board, now_ns);
    self->state = LIBRARY_RUNS;
    write_log(self->mode == BOARD_MODE_FLY ? "started: fly" : self->mode == BOARD_MODE_BENCH ? "started: bench" : "started: record");
}

/* --- a call --- */

/* Every how many calls a tick is recorded. */
#define TICK_EVERY 10
/* Velocity, flag and quality stand in a row. */
#define FLOW_RECORD_BYTES 20

static void record_step(Library *self, const HalCommand *command, int64_t now_ns) {
    float tick[TICK_FIELDS];
    struct {
        int32_t word;
        int16_t speeds[4];
    } motors = {command->command, {0, 0, 0, 0}};
    LoggedEvent event;
    for (int i = 0; i < 4 && command->motors_speed; i++) {
        motors.speeds[i] = command->motors_speed[i];
    }
    recorder_add(&self->recorder, RECORD_MOTORS, now_ns, &motors, sizeof motors);
    if (self->mode == BOARD_MODE_FLY && self->calls % TICK_EVERY == 0) {
        for (int i = 0; i < TICK_FIELDS; i++) {
            tick[i] = (float)self->autopilot.output.tick[i];
        }
        recorder_add(&self->recorder, RECORD_TICK, now_ns, tick, sizeof tick);
    }
    while (events_copy(&self->autopilot.events, &self->recorded_events, &event)) {
        recorder_add(&self->recorder, RECORD_EVENT, event.time_ns, event.text, (int32_t)strlen(event.text));
    }
}

static void fly(Library *self, const uint8_t *acquisition, const FlowCall *calls, int32_t call_count,
                HalCommand *command, int64_t now_ns) {
    uint8_t datagram[UDP_BYTES_MAX];
    Autopilot *autopilot = &self->autopilot;
    autopilot_receive_sensors(autopilot, acquisition, calls, call_count, now_ns);
    for (int32_t i = 0; i < self->image.settings.board.link.datagrams_max; i++) {
        int32_t size = udp_receive(&self->offboard, datagram);
        if (size < 0) {
            break;
        }
        autopilot_receive_offboard(autopilot, datagram, (size_t)size, now_ns);
    }
    autopilot_step(autopilot, command, now_ns);
    const Datagram *one;
    for (int32_t i = 0; (one = autopilot_datagram(autopilot, i)) != NULL; i++) {
        udp_send(&self->offboard, one->bytes, (size_t)one->size);
    }
}

void library_control(Library *self, const uint8_t *acquisition, HalCommand *command) {
    int64_t now_ns = dmrac_clock_ns();
    FlowCall calls[FLOW_CALLS_MAX];
    if (self->state == LIBRARY_NEW) {
        library_start(self, now_ns);
    }
    if (self->state != LIBRARY_RUNS) {
        command->command = MOTORS_STOP;
        return;
    }
    if (!autopilot_begin(&self->autopilot, command, now_ns)) {
        return;
    }
    command->ultrasound_command = self->calls++ == 0 ? ULTRASOUND_START : 0;
    int32_t call_count = flow_queue_take(&self->flows, calls);
    recorder_add_acquisition(&self->recorder, acquisition, now_ns);
    for (int32_t i = 0; i < call_count; i++) {
        recorder_add(&self->recorder, RECORD_FLOW, calls[i].time_ns, calls[i].velocity, FLOW_RECORD_BYTES);
    }
    if (self->mode == BOARD_MODE_FLY) {
        fly(self, acquisition, calls, call_count, command, now_ns);
    } else if (self->mode == BOARD_MODE_BENCH) {
        bench_step(&self->bench, &self->autopilot.motors, command, now_ns);
    } else {
        motors_stop(&self->autopilot.motors, command);
    }
    record_step(self, command, now_ns);
    autopilot_end(&self->autopilot, dmrac_clock_ns());
}

void library_view(const Library *self, DmracView *out) {
    const Autopilot *autopilot = &self->autopilot;
    const Core *core = &autopilot->core;
    *out = (DmracView){
        .state = self->state,
        .mode = core->mode,
        .check = autopilot->check,
        .stage = autopilot->calls.stage,
        .calls = autopilot->calls.calls,
        .missed = autopilot->calls.missed,
        .twice = autopilot->calls.twice,
        .late = autopilot->calls.late,
        .over_budget = autopilot->calls.over_total,
        .left_out = autopilot->datagrams_left_out,
        .version = core->reception.version,
        .swaps = core->reception.swaps,
        .refusals = core->reception.refusals,
        .taken_back = core->reception.taken_back,
        .samples_taken = core->samples.taken,
        .samples_dropped = core->samples.dropped,
        .samples_repeated = core->samples.repeated,
    };
    memcpy(out->dropped, autopilot->reader.dropped, sizeof out->dropped);
    memcpy(out->rejected, core->offboard.endpoint.statistics.rejected, sizeof out->rejected);
    memcpy(out->tick, autopilot->output.tick, sizeof out->tick);
}
