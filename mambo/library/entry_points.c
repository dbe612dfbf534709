/* The functions that the firmware calls. */
#include <stdio.h>
#include <string.h>

#include "clock.h"
#include "library.h"

static Library library;

void RSEDU_control(const void *acquisition, HalCommand *command) {
    library_control(&library, acquisition, command);
}

void RSEDU_optical_flow(float vx, float vy, float vz, int defined, float quality) {
    FlowCall call = {dmrac_clock_ns(), {vx, vy, vz}, defined, quality};
    flow_queue_put(&library.flows, &call);
    recorder_drain(&library.recorder);
}

void RSEDU_image_processing(const void *image) {
    (void)image;
    recorder_drain(&library.recorder);
}

void dmrac_view(DmracView *out) {
    library_view(&library, out);
}

int dmrac_take_event(int64_t *time_ns, char text[100]) {
    static int64_t read;
    LoggedEvent event;
    if (!events_copy(&library.autopilot.events, &read, &event)) {
        return 0;
    }
    *time_ns = event.time_ns;
    memcpy(text, event.text, sizeof event.text);
    return 1;
}

const char *dmrac_fault(void) {
    return library.fault.text;
}
