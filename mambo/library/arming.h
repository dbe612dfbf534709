/* What must be true before the vehicle is armed, beside the supervisor's own limits: the firmware's calls, the sensors
 * of a vehicle that stands still, optical flow, and the pose against the IMU. The library's part of
 * onboard/flight/arming.py, onboard/links/health.py and onboard/estimation/pose_health.py, with the same limits. Not
 * evaluated in flight. */
#ifndef DMRAC_MAMBO_ARMING_H
#define DMRAC_MAMBO_ARMING_H

#include "call_watch.h"
#include "estimation/readings.h"
#include "generated/settings.h"

/* Why the vehicle must not be armed; the number goes to the core (CoreInputs.preflight). */
typedef enum {
    CHECK_PASSED,
    CHECK_NOT_CLEARED,  /* dmrac mambo check has not passed with these settings */
    CHECK_STOPPED,      /* the firmware, or a call that came too late, has ended the flight */
    CHECK_NOT_JUDGED,   /* not enough calls or samples yet */
    CHECK_RATE,         /* of the calls */
    CHECK_GAP,          /* between two calls */
    CHECK_SLOW,         /* the library takes too long */
    CHECK_FROZEN,       /* the acquisition repeats */
    CHECK_STUCK,        /* an axis never changes */
    CHECK_GRAVITY,      /* not 1 g at rest */
    CHECK_GRAVITY_AXIS, /* gravity is not on body z: axes swapped, or the vehicle lies on its side */
    CHECK_UPSIDE_DOWN,  /* or a wrong sign */
    CHECK_TURNS,        /* the vehicle moves, or a wrong bias or unit */
    CHECK_NO_FLOW,
    CHECK_NO_POSE, /* waiting for the first pose */
    CHECK_POSE_RATE,
    CHECK_POSE_TILT, /* pose and IMU disagree */
    CHECK_POSE_FLOOR /* its zero is not the floor */
} ArmingCheck;

#define REST_BLOCK_SAMPLES 50
#define REST_BLOCKS 4
#define POSES_JUDGED 32

/* Some samples in a row: accelerometer and gyroscope. */
typedef struct {
    real sum[6];
    real first[6];
    bool changes[6];
    int32_t samples;
} RestBlock;

typedef struct {
    int64_t arrival_ns;
    real down_m;
    real down_axis[3]; /* the world's down, in the body */
} JudgedPose;

typedef struct {
    ArmingLimits limits;
    RestBlock blocks[REST_BLOCKS]; /* a ring of full blocks */
    int32_t block_count;
    RestBlock present;
    int64_t flow_ns;
    int64_t started_ns;
    bool started;
    JudgedPose poses[POSES_JUDGED]; /* a ring */
    int64_t pose_count;
} ArmingChecks;

void arming_checks_init(ArmingChecks *self, const ArmingLimits *limits);
void arming_checks_note_imu(ArmingChecks *self, const ImuReading *reading);
void arming_checks_note_flow(ArmingChecks *self, int64_t time_ns);
void arming_checks_note_pose(ArmingChecks *self, const Pose *pose, int64_t arrival_ns);

/* The first reason. `posed`: a pose has been used. `frozen`: the acquisition repeats. */
ArmingCheck arming_checks_judge(ArmingChecks *self, const CallWatch *calls, bool posed, bool frozen, int64_t now_ns);

/* A reason in words, for log and ground station. */
const char *arming_check_text(ArmingCheck check);

#endif
