/* The library's part of a flight, without sockets, files and clock: acquisition and datagrams in, motor commands and
 * datagrams out. It joins readings, watchdogs, arming checks and the flight core.
 *
 *     autopilot_begin; autopilot_receive_... for what has come; autopilot_step; autopilot_end with the time of the end
 */
#ifndef DMRAC_AUTOPILOT_H
#define DMRAC_AUTOPILOT_H

#include "arming.h"
#include "call_watch.h"
#include "core.h"
#include "events.h"
#include "image.h"
#include "motors.h"
#include "readings.h"

/* A datagram of offboard longer than this is a chunk of features; poses and answers are shorter. */
#define SHORT_DATAGRAM_BYTES 200

typedef struct {
    Core core;
    SensorReader reader;
    CallWatch calls;
    ArmingChecks arming;
    Motors motors;
    bool heed_stop;
    bool features_in_flight;
    bool received; /* a pose, a chunk or flow, in this call */
    int64_t last_ns;
    int64_t ground_ns;      /* arrival of the ground station's newest datagram; NEVER_NS before */
    ArmingCheck check;      /* of the last step */
    ArmingCheck ended;      /* CHECK_STOPPED once the flight was ended from outside */
    BatteryReading battery; /* the newest */
    FlightMode mode;        /* of the last step */
    bool frozen;
    int64_t datagrams_left_out;
    CoreOutput output;
    Events events;
} Autopilot;

/* False for a key of a size that is not allowed; `self` must not be used then. */
bool autopilot_init(Autopilot *self, const Image *image, uint64_t session);

/* A call of the firmware begins. False if it is the last one again: the commands of that one are still right. */
bool autopilot_begin(Autopilot *self, const HalCommand *command, int64_t now_ns);

void autopilot_receive_sensors(Autopilot *self, const uint8_t *acquisition, const FlowCall *calls, int32_t call_count,
                               int64_t now_ns);
/* Whether it held a pose or a chunk of features: those cost much of a call, so the next datagram is left to the next one. */
bool autopilot_receive_offboard(Autopilot *self, const uint8_t *datagram, size_t size, int64_t now_ns);
/* A command of the pilot; `refusal` says why it is refused, or that it is not. */
void autopilot_command(Autopilot *self, Command command, int64_t now_ns, ArmingRefusal *refusal);

/* One tick of the core, and the motor commands. */
void autopilot_step(Autopilot *self, HalCommand *command, int64_t now_ns);

/* Datagram `index` of the last step to offboard, from 0; NULL behind the last one. */
const Datagram *autopilot_datagram(const Autopilot *self, int32_t index);

/* The call has ended. */
void autopilot_end(Autopilot *self, int64_t end_ns);

#endif
