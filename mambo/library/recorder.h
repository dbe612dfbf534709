/* Records of a run for the laptop: acquisitions, flow, events and ticks. The 200 Hz call only copies them to a ring;
 * the firmware's other threads write the ring to a file. mambo/recording.py reads the file.
 *
 *     "DMRR", version (32-bit), then records: kind (8-bit), 0 (8-bit), size of the content (16-bit), time (64-bit, ns),
 * content */
#ifndef DMRAC_MAMBO_RECORDER_H
#define DMRAC_MAMBO_RECORDER_H

#include <stdbool.h>
#include <stdint.h>

#include "firmware.h"
#include "generated/settings.h"

#define RECORDER_RING_BYTES (256 * 1024)

typedef enum {
    RECORD_SAMPLE = 1, /* floats: accelerometer 3, gyroscope 3, FIFO accelerometer 15, FIFO gyroscope 15, pressure,
                          altitude, battery voltage; then the battery's per cent, 32-bit */
    RECORD_WHOLE = 2,  /* the acquisition structure */
    RECORD_FLOW = 3,   /* floats vx, vy, vz; defined, 32-bit; float quality */
    RECORD_EVENT = 4,  /* text */
    RECORD_TICK = 5,   /* floats of onboard/record/tick.py */
    RECORD_MOTORS = 6  /* word, 32-bit; speeds 4 x 16-bit */
} RecordKind;

typedef struct {
    BoardLayout layout;
    int32_t whole_every;
    int64_t end_ns; /* nothing is recorded from then on */
    int64_t calls;
    int64_t lost; /* records that found no room */
    int descriptor;
    uint8_t ring[RECORDER_RING_BYTES];
    volatile uint32_t written; /* by the 200 Hz call alone */
    volatile uint32_t drained; /* by the thread that holds `draining` alone */
    volatile int32_t draining;
} Recorder;

/* Begin the file at `path`; without one nothing is recorded. */
void recorder_open(Recorder *self, const char *path, const BoardConfig *config, int64_t now_ns);

/* A record, or none if the ring is full. For the 200 Hz call only. */
void recorder_add(Recorder *self, RecordKind kind, int64_t time_ns, const void *content, int32_t size);

/* One call's acquisition, and now and then all of it. */
void recorder_add_acquisition(Recorder *self, const uint8_t *acquisition, int64_t time_ns);

/* Write what waits. From any other thread; returns at once if another one is writing. */
void recorder_drain(Recorder *self);

#endif
