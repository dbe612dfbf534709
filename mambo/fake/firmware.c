/* A stand-in for the drone's firmware: it loads the real library and calls it as the firmware does, with the structures
 * of the firmware. Requests come on standard input, one for each call, and are answered on standard output:
 * mambo/fake/wire.py is the other side. Time is that of the requests.
 *
 *     firmware LIBRARY
 *
 * Flow calls come from a thread of their own, as the camera's do; the answer to a request waits for it, so that a
 * flight is repeatable. The structure is declared here once more, by its members: it checks the offsets that the
 * library reads. */
#define _GNU_SOURCE
#include "firmware.h"

#include <dlfcn.h>
#include <pthread.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "clock.h"
#include "view.h"

/* --- the acquisition structure, member by member --- */

typedef struct {
    float x, y, z;
} Vector;

typedef struct {
    int32_t read_calls;
    int32_t gap_0;
    int64_t timestamp_us;
    uint16_t status;
    uint8_t used;
    uint8_t users;
    Vector accelerometer;
    float accelerometer_temperature_c;
    Vector gyroscope;
    float gyroscope_temperature_c;
    int32_t gyroscope_temperature_lsb;
    uint16_t fifo_count;
    uint16_t gap_1[3];
    int64_t fifo_timestamp_us;
    Vector fifo_gyroscope_corrected[FIFO_SAMPLES];
    Vector fifo_accelerometer_corrected[FIFO_SAMPLES];
    Vector fifo_gyroscope[FIFO_SAMPLES];
    Vector fifo_accelerometer[FIFO_SAMPLES];
    uint8_t gap_2[48];
    float pressure_pa;
    uint8_t gap_3[20];
    float altitude_m;
    uint8_t gap_4[1196];
    float battery_v;
    uint32_t battery_percent;
    uint8_t gap_5[840];
} Acquisition;

#define STANDS_AT(member, place) typedef char member##_stands_at[offsetof(Acquisition, member) == (place) ? 1 : -1]
STANDS_AT(accelerometer, 20);
STANDS_AT(gyroscope, 36);
STANDS_AT(fifo_gyroscope, 192);
STANDS_AT(fifo_accelerometer, 252);
STANDS_AT(pressure_pa, 360);
STANDS_AT(altitude_m, 384);
STANDS_AT(battery_v, 1584);
STANDS_AT(battery_percent, 1588);
typedef char acquisition_has_its_size[sizeof(Acquisition) == ACQUISITION_BYTES ? 1 : -1];
#ifdef __arm__
typedef char speeds_stand_at_4[offsetof(HalCommand, motors_speed) == 4 ? 1 : -1];
typedef char ultrasound_stands_at_12[offsetof(HalCommand, ultrasound_command) == 12 ? 1 : -1];
#endif

/* --- requests and answers --- */

enum { CALLS_CONTROL = 1, CALLS_FLOW = 2, CALLS_TWICE = 4, STOPS_MOTORS = 8, FREEZES = 16, CALLS_IMAGE = 32 };

typedef struct {
    int64_t now_ns;
    int64_t wall_ns;
    int64_t spent_ns; /* that the call takes, in virtual time */
    int32_t calls;
    float accelerometer[FIFO_SAMPLES * 3];
    float gyroscope[FIFO_SAMPLES * 3];
    float pressure_pa;
    float altitude_m;
    float battery_v;
    uint32_t battery_percent;
    float flow[3];
    int32_t flow_defined;
    float flow_quality;
} Request;

typedef struct {
    int32_t word;
    int16_t speeds[4];
    int32_t ultrasound;
    int32_t events; /* texts that follow */
    DmracView view;
} Answer;

typedef struct {
    int64_t time_ns;
    char text[104];
} AnsweredEvent;

static int64_t clock_ns, wall_ns, spent_ns;

/* The library's clocks are those of the requests; within a call the second reading is `spent_ns` later. */
static int readings_of_clock;

int64_t dmrac_clock_ns(void) {
    return readings_of_clock++ ? clock_ns + spent_ns : clock_ns;
}

int64_t dmrac_wall_clock_ns(void) {
    return wall_ns;
}

/* --- the library --- */

static struct {
    void (*control)(const void *, HalCommand *);
    void (*optical_flow)(float, float, float, int, float);
    void (*image_processing)(const void *);
    void (*view)(DmracView *);
    int (*take_event)(int64_t *, char *);
    const char *(*fault)(void);
} library;

static void *symbol(void *handle, const char *name) {
    void *found = dlsym(handle, name);
    if (!found) {
        fprintf(stderr, "the library has no %s\n", name);
        exit(2);
    }
    return found;
}

#ifdef LIBRARY_INSIDE /* a static program, whose addresses the counting of cycles knows */
static void load(const char *path) {
    (void)path;
    (void)symbol;
    library.control = RSEDU_control;
    library.optical_flow = RSEDU_optical_flow;
    library.image_processing = RSEDU_image_processing;
    library.view = dmrac_view;
    library.take_event = dmrac_take_event;
    library.fault = dmrac_fault;
}
#else
static void load(const char *path) {
    void *handle = dlopen(path, RTLD_NOW);
    if (!handle) {
        fprintf(stderr, "%s\n", dlerror());
        exit(2);
    }
    *(void **)&library.control = symbol(handle, "RSEDU_control");
    *(void **)&library.optical_flow = symbol(handle, "RSEDU_optical_flow");
    *(void **)&library.image_processing = symbol(handle, "RSEDU_image_processing");
    *(void **)&library.view = symbol(handle, "dmrac_view");
    *(void **)&library.take_event = symbol(handle, "dmrac_take_event");
    *(void **)&library.fault = symbol(handle, "dmrac_fault");
}
#endif

/* Marks the end of a call for whoever counts instructions; its beginning is RSEDU_control. */
__attribute__((noinline)) void firmware_call_ended(void);
__attribute__((noinline)) void firmware_call_ended(void) {
    __asm__ volatile("");
}

/* --- the camera's thread --- */

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static pthread_cond_t turn = PTHREAD_COND_INITIALIZER;
static const Request *wanted; /* the flow to give; NULL: done */

static void *camera(void *unused) {
    (void)unused;
    pthread_mutex_lock(&lock);
    for (;;) {
        while (!wanted) {
            pthread_cond_wait(&turn, &lock);
        }
        const Request *one = wanted;
        library.optical_flow(one->flow[0], one->flow[1], one->flow[2], one->flow_defined, one->flow_quality);
        wanted = NULL;
        pthread_cond_signal(&turn);
    }
    return NULL;
}

static void give_flow(const Request *request) {
    pthread_mutex_lock(&lock);
    wanted = request;
    pthread_cond_signal(&turn);
    while (wanted) {
        pthread_cond_wait(&turn, &lock);
    }
    pthread_mutex_unlock(&lock);
}

/* --- a call --- */

static void fill(Acquisition *to, const Request *from) {
    to->read_calls++;
    to->timestamp_us = from->now_ns / 1000;
    to->fifo_count = FIFO_SAMPLES;
    memcpy(to->fifo_accelerometer, from->accelerometer, sizeof from->accelerometer);
    memcpy(to->fifo_gyroscope, from->gyroscope, sizeof from->gyroscope);
    to->accelerometer = to->fifo_accelerometer[FIFO_SAMPLES - 1];
    to->gyroscope = to->fifo_gyroscope[FIFO_SAMPLES - 1];
    to->pressure_pa = from->pressure_pa;
    to->altitude_m = from->altitude_m;
    to->battery_v = from->battery_v;
    to->battery_percent = from->battery_percent;
}

static bool all_of(int descriptor, void *bytes, size_t size) {
    for (size_t at = 0; at < size;) {
        ssize_t got = read(descriptor, (char *)bytes + at, size - at);
        if (got <= 0) {
            return false;
        }
        at += (size_t)got;
    }
    return true;
}

static void answer(const HalCommand *command) {
    static struct {
        Answer answer;
        AnsweredEvent events[16];
    } out;
    int32_t count = 0;
    memset(&out, 0, sizeof out);
    out.answer.word = command->command;
    memcpy(out.answer.speeds, command->motors_speed, sizeof out.answer.speeds);
    out.answer.ultrasound = command->ultrasound_command;
    library.view(&out.answer.view);
    while (count < 16 && library.take_event(&out.events[count].time_ns, out.events[count].text)) {
        count++;
    }
    if (count < 16 && out.answer.view.state == 1) { /* refused: the reason is the event */
        out.events[count].time_ns = clock_ns;
        snprintf(out.events[count++].text, sizeof out.events[0].text, "%.103s", library.fault());
    }
    out.answer.events = count;
    size_t size = sizeof out.answer + (size_t)count * sizeof out.events[0];
    if (write(STDOUT_FILENO, &out, size) != (ssize_t)size) {
        exit(1);
    }
}

int main(int count, char **arguments) {
    static Acquisition acquisition;
    static int16_t speeds[4];
    static Request request;
    HalCommand command = {.motors_speed = speeds};
    pthread_t thread;
    if (count != 2) {
        fprintf(stderr, "usage: firmware LIBRARY\n");
        return 2;
    }
    load(arguments[1]);
    if (pthread_create(&thread, NULL, camera, NULL) != 0) {
        fprintf(stderr, "no thread for the camera\n");
        return 2;
    }
    while (all_of(STDIN_FILENO, &request, sizeof request)) {
        clock_ns = request.now_ns;
        wall_ns = request.wall_ns;
        spent_ns = 0;
        readings_of_clock = 0;
        if (request.calls & CALLS_FLOW) {
            give_flow(&request);
        }
        if (request.calls & CALLS_IMAGE) {
            library.image_processing(NULL);
        }
        if (!(request.calls & FREEZES)) {
            fill(&acquisition, &request);
        }
        if (request.calls & STOPS_MOTORS) {
            command.command = MOTORS_STOP;
        }
        for (int i = 0; i < ((request.calls & CALLS_CONTROL) ? 1 : 0) + ((request.calls & CALLS_TWICE) ? 1 : 0); i++) {
            readings_of_clock = 0;
            spent_ns = request.spent_ns;
            library.control(&acquisition, &command);
            firmware_call_ended();
        }
        answer(&command);
    }
    return 0;
}
