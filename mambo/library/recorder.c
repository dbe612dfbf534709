#define _GNU_SOURCE
#include "recorder.h"

#include <fcntl.h>
#include <string.h>
#include <unistd.h>

#include "atomic.h"

#define HEADER_BYTES_OF_RECORD 12
#define SAMPLE_BYTES_OF_RECORD (4 * (3 + 3 + 15 + 15 + 3 + 1))

void recorder_open(Recorder *self, const char *path, const BoardConfig *config, int64_t now_ns) {
    static const uint8_t header[8] = {'D', 'M', 'R', 'R', 1, 0, 0, 0};
    self->layout = config->layout;
    self->whole_every = config->record.whole_every;
    self->end_ns = now_ns + (int64_t)(1e9 * (double)config->record.duration_s);
    self->descriptor = open(path, O_WRONLY | O_CREAT | O_TRUNC, 0600);
    if (self->descriptor >= 0 && write(self->descriptor, header, sizeof header) != (ssize_t)sizeof header) {
        close(self->descriptor);
        self->descriptor = -1;
    }
}

static void put(Recorder *self, uint32_t at, const uint8_t *bytes, uint32_t size) {
    for (uint32_t i = 0; i < size;) {
        uint32_t place = (at + i) % RECORDER_RING_BYTES;
        uint32_t part = size - i < RECORDER_RING_BYTES - place ? size - i : RECORDER_RING_BYTES - place;
        memcpy(self->ring + place, bytes + i, part);
        i += part;
    }
}

void recorder_add(Recorder *self, RecordKind kind, int64_t time_ns, const void *content, int32_t size) {
    uint8_t header[HEADER_BYTES_OF_RECORD] = {(uint8_t)kind, 0, (uint8_t)(size & 0xff), (uint8_t)(size >> 8)};
    uint32_t all = (uint32_t)(HEADER_BYTES_OF_RECORD + size);
    if (self->descriptor < 0 || time_ns >= self->end_ns) {
        return;
    }
    if (RECORDER_RING_BYTES - (self->written - self->drained) < all) {
        self->lost++;
        return;
    }
    memcpy(header + 4, &time_ns, sizeof time_ns);
    put(self, self->written, header, HEADER_BYTES_OF_RECORD);
    put(self, self->written + HEADER_BYTES_OF_RECORD, content, (uint32_t)size);
    atomic_barrier();
    self->written += all;
}

void recorder_add_acquisition(Recorder *self, const uint8_t *acquisition, int64_t time_ns) {
    const BoardLayout *layout = &self->layout;
    uint8_t sample[SAMPLE_BYTES_OF_RECORD];
    const struct {
        int32_t place;
        int32_t size;
    } fields[] = {
        {layout->accelerometer, 12},  {layout->gyroscope, 12},      {layout->fifo_accelerometer, 60},
        {layout->fifo_gyroscope, 60}, {layout->pressure, 4},        {layout->altitude, 4},
        {layout->battery_voltage, 4}, {layout->battery_percent, 4},
    };
    uint8_t *to = sample;
    for (unsigned i = 0; i < sizeof fields / sizeof fields[0]; i++) {
        memcpy(to, acquisition + fields[i].place, (size_t)fields[i].size);
        to += fields[i].size;
    }
    recorder_add(self, RECORD_SAMPLE, time_ns, sample, sizeof sample);
    if (self->calls++ % self->whole_every == 0) {
        recorder_add(self, RECORD_WHOLE, time_ns, acquisition, ACQUISITION_BYTES);
    }
}

void recorder_drain(Recorder *self) {
    if (self->descriptor < 0 || !atomic_take(&self->draining)) {
        return;
    }
    uint32_t waiting = self->written - self->drained;
    atomic_barrier();
    while (waiting > 0) {
        uint32_t place = self->drained % RECORDER_RING_BYTES;
        uint32_t part = waiting < RECORDER_RING_BYTES - place ? waiting : RECORDER_RING_BYTES - place;
        ssize_t done = write(self->descriptor, self->ring + place, part);
        if (done <= 0) {
            break;
        }
        self->drained += (uint32_t)done;
        waiting -= (uint32_t)done;
    }
    atomic_give_back(&self->draining);
}
