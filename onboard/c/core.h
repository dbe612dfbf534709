/* The onboard core: one tick, block by block. The twin of onboard/core.py, without what surrounds the blocks there: MAVLink,
 * the links to offboard and ground station, and the arming checks. Readings, poses and commands come in as numbers.
 *
 *     core_receive_... and core_command, in the order of arrival; core_tick; core_charge for what is sent beside samples */
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
#include "record/tick.h"
#include "sampling/sampler.h"
#include "sampling/signal_vector.h"

/* What the surroundings know in a tick. */
typedef struct {
    int64_t now_ns;       /* onboard's monotonic clock, which never goes back */
    int64_t missed_ticks; /* that the loop has skipped since its start; the last command was held meanwhile */
    int32_t preflight;    /* why the vehicle must not be armed, a number of the caller's; 0 if it may be */
    int64_t offboard_ns;  /* arrival of the newest datagram of offboard; NEVER_NS if there was none */
    int64_t ground_ns;    /* the same of the ground station */
    real link_loss;       /* share of the datagrams that the link to offboard loses */
} CoreInputs;

/* What a tick sends and records. Events stand in the order in which they happened. */
typedef struct {
    real motors[4]; /* shares of the maximum thrust */
    bool spinning;  /* whether the motors may turn; if not, they are off whatever `motors` says */
    FlightMode mode;
    EstimatorEvent estimator_events[ESTIMATOR_EVENTS_MAX];
    int32_t estimator_event_count;
    SupervisorEvent supervisor_events[SUPERVISOR_EVENTS_MAX];
    int32_t supervisor_event_count;
    VersionOutcome features;
    SampleBatch batches[BATCHES_MAX]; /* for the trainer */
    int32_t batch_count;
    double tick[TICK_FIELDS];
} CoreOutput;

typedef struct {
    AirframeConfig airframe;
    real period_s;
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
    FlightMode mode;
    BatteryReading battery;
    Target target;
    real command[4]; /* of the last tick, shares */
    bool saturated;
    bool land_requested;
    bool posed; /* a pose has been used */
    int64_t ticks;
    int64_t missed_ticks;
    real tracking_error_m; /* distance from the path, of the last tick */
} Core;

/* `start`: of both channels, the features that a flight starts with (control/laws/augmentation.h). */
void core_init(Core *self, const CoreConfig *config, const ChannelFeatures *start);

void core_receive_imu(Core *self, const ImuReading *reading);
void core_receive_flow(Core *self, const FlowReading *reading);
void core_receive_range(Core *self, const RangeReading *reading);
void core_receive_battery(Core *self, const BatteryReading *reading);

/* A pose that was true at `taken_ns` and arrived at `arrival_ns`. All of a tick's poses come after its readings. */
void core_receive_pose(Core *self, const Pose *pose, int64_t taken_ns, int64_t arrival_ns, real time_sigma_s);

/* A chunk of a feature version, as the codec has read it. A version that is complete by it is swapped in the next tick. */
void core_receive_chunk(Core *self, const FeatureChunk *chunk);

/* A new session of offboard: its versions may count from 1 again. */
void core_restart_offboard(Core *self);

/* A command of the pilot, or of the process around the core; `refusal` says why it is refused, or that it is not. */
void core_command(Core *self, Command command, int64_t now_ns, ArmingRefusal *refusal);

void core_tick(Core *self, const CoreInputs *inputs, CoreOutput *output);

/* Take a datagram to offboard that is not a sample batch from the byte budget. */
void core_charge(Core *self, int32_t datagram_bytes, int64_t now_ns);

#endif
