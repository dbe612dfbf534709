/* The link to the ground station: MAVLink 2 telemetry out, commands in. A smaller onboard/links/ground.py: at most one
 * message a call, answers and texts first. */
#ifndef DMRAC_MAMBO_GROUND_H
#define DMRAC_MAMBO_GROUND_H

#include "autopilot.h"
#include "mavlink.h"

typedef struct {
    Mavlink mavlink;
    int64_t read_events; /* of the autopilot */
    LoggedEvent event;   /* whose text is being sent, in chunks */
    size_t text_at;      /* of it; 0: none is being sent */
    uint32_t text_id;
    bool has_answer;
    uint8_t answer[10]; /* payload of COMMAND_ACK that waits */
    bool started;
    int64_t due_ns[4]; /* of attitude, position, heartbeat, system status */
} GroundLink;

void ground_init(GroundLink *self, const Image *image, int64_t wall_ns, int64_t now_ns);

/* A datagram of the ground station: its command goes to the autopilot. */
void ground_receive(GroundLink *self, Autopilot *autopilot, const uint8_t *datagram, size_t size, int64_t now_ns);

/* The most urgent message that is due; its size, 0 for none. */
size_t ground_poll(GroundLink *self, const Autopilot *autopilot, int64_t now_ns, uint8_t out[MAVLINK_FRAME_MAX]);

#endif
