/* Supervisor: chooses the flight mode by the table of generated/modes.c. The twin of onboard/flight/supervisor.py, which
 * explains it. Texts stay outside: an event is a few numbers, of which onboard/c/event_text.py makes numpy's text. */
#ifndef DMRAC_SUPERVISOR_H
#define DMRAC_SUPERVISOR_H

#include <stdbool.h>

#include "generated/config.h"
#include "generated/constants.h"
#include "generated/modes.h"

/* Events that wait to be taken; those beyond are lost and counted. */
#define SUPERVISOR_EVENTS_MAX 16

/* Why the vehicle must not be armed, or a command is refused. */
typedef enum {
    ARMING_ALLOWED,
    ARMING_PREFLIGHT, /* the number is the caller's */
    ARMING_NO_ATTITUDE,
    ARMING_NO_POSE,
    ARMING_NOT_LEVEL,
    ARMING_BATTERY_LOW,
    ARMING_BATTERY_HIGH,
    ARMING_BATTERY_EMPTY,
    ARMING_NO_BATTERY,
    ARMING_BATTERY_OLD,
    ARMING_NO_GROUND,
    ARMING_FENCE,
    ARMING_CALIBRATION, /* the number is the caller's */
    ARMING_OTHER_MODE,
    ARMING_NOT_RUNNING
} ArmingReason;

typedef struct {
    ArmingReason reason;
    int32_t number; /* of the caller, or the mode */
    real value;     /* what was measured */
    real limit;
} ArmingRefusal;

typedef enum {
    SUPERVISOR_REFUSED,   /* `command` and `refusal` */
    SUPERVISOR_ENTERED,   /* `from`, `to`, `event`; `refusal` if the sensors are not healthy */
    SUPERVISOR_SILENT,    /* offboard */
    SUPERVISOR_CONNECTED, /* offboard */
    SUPERVISOR_NOT_READY  /* `refusal` */
} SupervisorEventKind;

typedef struct {
    int64_t time_ns;
    SupervisorEventKind kind;
    Command command;
    FlightMode from;
    FlightMode to;
    Event event;
    ArmingRefusal refusal;
} SupervisorEvent;

/* Inputs of the supervisor in one step. */
typedef struct {
    int64_t now_ns;
    real imu_age_s;
    real pose_age_s;
    real velocity_aid_age_s;
    real offboard_age_s;
    real ground_age_s;
    real battery_age_s;
    real battery_v;
    real battery_remaining; /* fraction; negative when unknown */
    real tilt_rad;
    real height_m;   /* above the floor */
    real climb_m_s;  /* positive upwards */
    real distance_m; /* from the origin, horizontally */
    real position_sigma_m;
    real thrust_to_weight; /* collective thrust of the actuator model over weight */
    bool initialised;      /* the attitude is known */
    int32_t preflight;     /* why the vehicle must not be armed; 0 if it may be */
    int32_t calibration;   /* why the calibration of the IMU forbids arming; 0 if it does not */
    bool fault;            /* the estimate is not finite */
    bool gyro_stuck;       /* the rate of an axis comes from the motors */
} SupervisorInputs;

typedef struct {
    SupervisorConfig config;
    FlightMode mode;
    int64_t since_ns[EVENT_COUNT]; /* since when a condition has been true; NEVER_NS: it is not */
    bool timed;
    int64_t timed_from_ns;
    real lowest_m;
    bool offboard_silent;
    ArmingReason not_ready;
    int32_t not_ready_number;
    int64_t not_ready_since_ns;
    bool not_ready_reported;
    bool flown;
    bool has_inputs;
    SupervisorInputs inputs;
    Command queue[COMMAND_QUEUE_MAX];
    int32_t queue_count;
    int32_t command; /* of this step; -1: none */
    SupervisorEvent events[SUPERVISOR_EVENTS_MAX];
    int32_t event_count;
    int32_t events_lost;
} Supervisor;

void supervisor_init(Supervisor *self, const SupervisorConfig *config);

/* Queue a command for the next step; `refusal` says why it is refused, or that it is not. */
void supervisor_command(Supervisor *self, Command command, int64_t now_ns, ArmingRefusal *refusal);

/* The first reason to refuse arming. */
void supervisor_arming_refusal(const Supervisor *self, const SupervisorInputs *inputs, ArmingRefusal *refusal);

/* Read the row of the present mode and make at most one transition. */
FlightMode supervisor_step(Supervisor *self, const SupervisorInputs *inputs);

/* Copy the events since the last call and forget them; returns their number. */
int32_t supervisor_take_events(Supervisor *self, SupervisorEvent *events);

#endif
