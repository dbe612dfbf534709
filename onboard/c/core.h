/* The onboard core: one tick, block by block. The twin of onboard/core.py, without what speaks MAVLink there: the links to
 * vehicle and ground station, and the arming checks. Readings and commands come in as numbers.
 *
 *     core_receive_... and core_command for what came since the last tick, in the order of arrival; then core_tick */
#ifndef DMRAC_CORE_H
#define DMRAC_CORE_H

#include "control/actuators.h"
#include "control/cascade.h"
#include "control/feature_reception.h"
#include "control/mixer.h"
#include "control/thrust_scale.h"
#include "control/uncertainty.h"
#include "estimation/estimator.h"
#include "flight/guidance.h"
#include "flight/supervisor.h"
#include "links/offboard.h"
#include "record/tick.h"
#include "sampling/sampler.h"
#include "sampling/signal_vector.h"

/* Datagrams to offboard of one tick: samples, time sync and a status. */
#define TO_OFFBOARD_MAX (BATCHES_MAX + SYNC_DATAGRAMS_MAX + 1)

/* What the surroundings know in a tick. */
typedef struct {
    int64_t now_ns;       /* onboard's monotonic clock, which never goes back */
    int64_t missed_ticks; /* that the loop has skipped since its start; the last command was held meanwhile */
    int32_t preflight;    /* why the vehicle must not be armed, a number of the caller's; 0 if it may be */
    int64_t ground_ns;    /* arrival of the newest datagram of the ground station; NEVER_NS if there was none */
    SpareTime spare;      /* for what can wait */
} CoreInputs;

/* What a tick sends and records. Events stand in the order in which they happened, block by block. */
typedef struct {
    real motors[4]; /* shares of the maximum thrust */
    bool spinning;  /* whether the motors may turn; if not, they are off whatever `motors` says */
    FlightMode mode;
    Datagram to_offboard[TO_OFFBOARD_MAX];
    int32_t to_offboard_count;
    bool status_sent;    /* whether a status is among them */
    bool has_clock;      /* once a second when it is known: */
    ClockExchange clock; /* offset and round trip of offboard's clock, for the log */
    LinkEvent link_events[LINK_EVENTS_MAX];
    int32_t link_event_count;
    EstimatorEvent estimator_events[ESTIMATOR_EVENTS_MAX];
    int32_t estimator_event_count;
    SupervisorEvent supervisor_events[SUPERVISOR_EVENTS_MAX];
    int32_t supervisor_event_count;
    VersionOutcome features;
    double tick[TICK_FIELDS];
} CoreOutput;

typedef struct {
    AirframeConfig airframe;
    real period_s;
    double whole_period_s; /* not rounded to a float, as whole_dt: path time adds it up */
    double whole_dt;
    real dt; /* s since the last tick */
    Estimator estimator;
    Supervisor supervisor;
    Guidance guidance;
    ActuatorModel actuators;
    ThrustScale thrust_scale;
    UncertaintyMeasurement uncertainty;
    SignalVector signals;
    FeatureReception reception;
    Cascade controller;
    Mixer mixer;
    SampleQueue samples;
    SampleBatch batches[BATCHES_MAX]; /* of this tick */
    OffboardLink offboard;
    FlightMode mode;
    BatteryReading battery;
    Target target;
    real command[4]; /* of the last tick, shares */
    bool saturated;
    bool land_requested;
    real stood_at_d; /* where the vehicle stood before this take-off, m, down */
    bool posed;      /* a pose has been used */
    int64_t ticks;
    int64_t missed_ticks;
    real tracking_error_m; /* distance from the path, of the last tick */
} Core;

/* `start`: of both channels, the features that a flight starts with (control/laws/augmentation.h). session, key: as of
 * offboard_link_init. False for a key of another size; `self` must not be used then. */
bool core_init(Core *self, const CoreConfig *config, const ChannelFeatures *start, uint64_t session, const uint8_t *key,
               int32_t key_size);

void core_receive_imu(Core *self, const ImuReading *reading);
void core_receive_flow(Core *self, const FlowReading *reading);
void core_receive_range(Core *self, const RangeReading *reading);
void core_receive_battery(Core *self, const BatteryReading *reading);

/* A datagram of offboard, of any bytes, after the readings of the tick. `received`: what was in it, for the caller's arming
 * checks. */
void core_receive_offboard(Core *self, const uint8_t *datagram, size_t size, int64_t arrival_ns, Received *received);

/* A command of the pilot, or of the process around the core; `refusal` says why it is refused, or that it is not. */
void core_command(Core *self, Command command, int64_t now_ns, ArmingRefusal *refusal);

void core_tick(Core *self, const CoreInputs *inputs, CoreOutput *output);

#endif
