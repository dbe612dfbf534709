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

static bool is_this_machine(const int32_t host[4]) {
    return host[0] == 127;
}

/* Without keys anybody on the radio could fly the vehicle. */
static bool has_keys_or_needs_none(Library *self) {
    const BoardLink *link = &self->image.settings.board.link;
    const char *missing = NULL;
    if (self->image.key_size == 0 && !is_this_machine(link->offboard)) {
        missing = "key: the link to another machine needs one";
    } else if (self->image.ground_key_size == 0 && link->ground_port != 0 && !is_this_machine(link->ground)) {
        missing = "ground key: a ground station on another machine needs one";
    }
    if (missing) {
        snprintf(self->fault.text, sizeof self->fault.text, "%s", missing);
    }
    return missing == NULL;
}

static bool open_links(Library *self, int64_t now_ns) {
    const BoardLink *link = &self->image.settings.board.link;
    if (!udp_open(&self->offboard, link->own_port, link->offboard, link->offboard_port)) {
        snprintf(self->fault.text, sizeof self->fault.text, "board.link.own_port %ld is taken", (long)link->own_port);
        return false;
    }
    ground_init(&self->ground, &self->image, (int64_t)(self->session >> 20) * 1000000, now_ns);
    if (link->ground_port && !udp_open(&self->ground_socket, link->ground_own_port, link->ground, link->ground_port)) {
        snprintf(self->fault.text, sizeof self->fault.text, "board.link.ground_own_port %ld is taken",
                 (long)link->ground_own_port);
        return false;
    }
    return true;
}

static bool start_autopilot(Library *self) {
    char path[PATH_BYTES];
    path_of(SESSION_FILE, path);
    self->session = next_session(path, dmrac_wall_clock_ns());
    if (autopilot_init(&self->autopilot, &self->image, self->session)) {
        return true;
    }
    snprintf(self->fault.text, sizeof self->fault.text, "key: %ld bytes are not allowed", (long)self->image.key_size);
    return false;
}

void library_start(Library *self, int64_t now_ns) {
    static const char *const modes[] = {"started: record", "started: bench", "started: fly"};
    char path[PATH_BYTES];
    self->recorder.descriptor = self->offboard.descriptor = self->ground_socket.descriptor = -1;
    if (!load_image(self) || !has_keys_or_needs_none(self) || !start_autopilot(self)) {
        refuse(self);
        return;
    }
    self->mode = self->image.settings.board.mode;
    if (self->mode == BOARD_MODE_FLY && !open_links(self, now_ns)) {
        refuse(self);
        return;
    }
    bench_init(&self->bench, &self->image.settings.board.record);
    path_of(RECORD_FILE, path);
    recorder_open(&self->recorder, path, &self->image.settings.board, now_ns);
    self->state = LIBRARY_RUNS;
    write_log(modes[self->mode]);
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

static void receive(Library *self, int64_t now_ns) {
    uint8_t datagram[UDP_BYTES_MAX];
    int32_t most = self->image.settings.board.link.datagrams_max, size;
    for (int32_t i = 0; i < most && (size = udp_receive(&self->ground_socket, datagram)) >= 0; i++) {
        ground_receive(&self->ground, &self->autopilot, datagram, (size_t)size, now_ns);
    }
    for (int32_t i = 0; i < most && (size = udp_receive(&self->offboard, datagram)) >= 0; i++) {
        if (autopilot_receive_offboard(&self->autopilot, datagram, (size_t)size, now_ns)) {
            break;
        }
    }
}

static void send_all(Library *self, int64_t now_ns) {
    uint8_t frame[MAVLINK_FRAME_MAX];
    const Datagram *one;
    for (int32_t i = 0; (one = autopilot_datagram(&self->autopilot, i)) != NULL; i++) {
        udp_send(&self->offboard, one->bytes, (size_t)one->size);
    }
    if (self->ground_socket.descriptor >= 0) {
        size_t size = ground_poll(&self->ground, &self->autopilot, now_ns, frame);
        if (size > 0) {
            udp_send(&self->ground_socket, frame, size);
        }
    }
}

static void fly(Library *self, const uint8_t *acquisition, const FlowCall *calls, int32_t call_count,
                HalCommand *command, int64_t now_ns) {
    autopilot_receive_sensors(&self->autopilot, acquisition, calls, call_count, now_ns);
    receive(self, now_ns);
    autopilot_step(&self->autopilot, command, now_ns);
    send_all(self, now_ns);
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
    } else if (self->mode == BOARD_MODE_BENCH && self->autopilot.ended == CHECK_PASSED) {
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
