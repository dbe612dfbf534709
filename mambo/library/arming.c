#include "arming.h"

#include <string.h>

#include "generated/constants.h"
#include "numerics/elementary.h"
#include "protocol/geometry.h"

void arming_checks_init(ArmingChecks *self, const ArmingLimits *limits) {
    memset(self, 0, sizeof *self);
    self->limits = *limits;
    self->flow_ns = NEVER_NS;
}

/* --- what is collected --- */

void arming_checks_note_imu(ArmingChecks *self, const ImuReading *reading) {
    RestBlock *block = &self->present;
    real values[6];
    vector_copy(reading->accelerometer, values);
    vector_copy(reading->gyroscope, values + 3);
    if (block->samples == 0) {
        memcpy(block->first, values, sizeof values);
    }
    for (int i = 0; i < 6; i++) {
        block->sum[i] += values[i];
        block->changes[i] = block->changes[i] || values[i] != block->first[i];
    }
    if (++block->samples == REST_BLOCK_SAMPLES) {
        self->blocks[self->block_count++ % REST_BLOCKS] = *block;
        memset(block, 0, sizeof *block);
    }
}

void arming_checks_note_flow(ArmingChecks *self, int64_t time_ns) {
    self->flow_ns = time_ns;
}

void arming_checks_note_pose(ArmingChecks *self, const Pose *pose, int64_t arrival_ns) {
    JudgedPose *judged = self->poses + self->pose_count++ % POSES_JUDGED;
    real rotation[9];
    rotation_of(pose->quaternion, rotation);
    judged->arrival_ns = arrival_ns;
    judged->down_m = pose->position[2];
    vector_copy(rotation + 6, judged->down_axis);
}

/* --- what is judged --- */

/* Means of the newest blocks; false before there are enough. */
static bool means(const ArmingChecks *self, real out[6], bool changes[6]) {
    memset(out, 0, 6 * sizeof(real));
    memset(changes, 0, 6 * sizeof(bool));
    if (self->block_count < REST_BLOCKS) {
        return false;
    }
    for (int i = 0; i < REST_BLOCKS; i++) {
        for (int j = 0; j < 6; j++) {
            out[j] += self->blocks[i].sum[j] / (real)(REST_BLOCKS * REST_BLOCK_SAMPLES);
            changes[j] = changes[j] || self->blocks[i].changes[j];
        }
    }
    return true;
}

static ArmingCheck judge_rest(const ArmingChecks *self) {
    const ArmingLimits *limits = &self->limits;
    real mean[6];
    bool changes[6];
    if (!means(self, mean, changes)) {
        return CHECK_NOT_JUDGED;
    }
    for (int i = 0; i < 6; i++) {
        if (!changes[i]) {
            return CHECK_STUCK;
        }
    }
    if (!(real_abs(vector_length(mean) - GRAVITY) <= limits->gravity_tolerance_m_s2)) {
        return CHECK_GRAVITY;
    }
    if (real_abs(mean[2]) < real_max(real_abs(mean[0]), real_abs(mean[1]))) {
        return CHECK_GRAVITY_AXIS;
    }
    if (mean[2] > REAL(0.0)) {
        return CHECK_UPSIDE_DOWN;
    }
    for (int i = 3; i < 6; i++) {
        if (!(real_abs(mean[i]) <= limits->rest_rate_max_rad_s)) {
            return CHECK_TURNS;
        }
    }
    return CHECK_PASSED;
}

static ArmingCheck judge_calls(const ArmingChecks *self, const CallWatch *calls) {
    if (!(calls->rate_hz > REAL(0.0))) {
        return CHECK_NOT_JUDGED;
    }
    if (call_watch_wrong_rate(calls)) {
        return CHECK_RATE;
    }
    if ((real)((double)calls->gap_ns * 1e-9) > self->limits.gap_max_s) {
        return CHECK_GAP;
    }
    return calls->stage == BUDGET_KEPT ? CHECK_PASSED : CHECK_SLOW;
}

static ArmingCheck judge_poses(const ArmingChecks *self) {
    const ArmingLimits *limits = &self->limits;
    real mean[6], down_m = REAL(0.0), axis[3] = {REAL(0.0), REAL(0.0), REAL(0.0)};
    bool changes[6];
    if (self->pose_count < POSES_JUDGED || !means(self, mean, changes)) {
        return CHECK_NOT_JUDGED;
    }
    int64_t oldest_ns = self->poses[self->pose_count % POSES_JUDGED].arrival_ns;
    int64_t newest_ns = self->poses[(self->pose_count - 1) % POSES_JUDGED].arrival_ns;
    real seconds = (real)((double)(newest_ns - oldest_ns) * 1e-9);
    if (!((real)(POSES_JUDGED - 1) >= limits->pose_rate_min_hz * seconds)) {
        return CHECK_POSE_RATE;
    }
    for (int i = 0; i < POSES_JUDGED; i++) {
        down_m += self->poses[i].down_m / (real)POSES_JUDGED;
        vector_add(axis, self->poses[i].down_axis, axis);
    }
    real length = vector_length(mean) * vector_length(axis);
    if (!(length > REAL(0.0))) {
        return CHECK_NOT_JUDGED;
    }
    real cosine = -(mean[0] * axis[0] + mean[1] * axis[1] + mean[2] * axis[2]) / length;
    if (real_acos(real_clip(cosine, REAL(-1.0), REAL(1.0))) > limits->upright_tolerance_rad) {
        return CHECK_POSE_TILT;
    }
    return real_abs(down_m) > limits->floor_tolerance_m ? CHECK_POSE_FLOOR : CHECK_PASSED;
}

static real seconds_since(int64_t then_ns, int64_t now_ns) {
    return (real)((double)(now_ns - then_ns) * 1e-9);
}

ArmingCheck arming_checks_judge(ArmingChecks *self, const CallWatch *calls, bool posed, bool frozen, int64_t now_ns) {
    const ArmingLimits *limits = &self->limits;
    if (!self->started) {
        self->started = true;
        self->started_ns = now_ns;
    }
    if (!limits->cleared) {
        return CHECK_NOT_CLEARED;
    }
    if (frozen) {
        return CHECK_FROZEN;
    }
    ArmingCheck check = judge_calls(self, calls);
    check = check == CHECK_PASSED ? judge_rest(self) : check;
    if (check != CHECK_PASSED) {
        return check;
    }
    if (limits->flow_silent_s > REAL(0.0) && seconds_since(self->flow_ns, now_ns) > limits->flow_silent_s) {
        return CHECK_NO_FLOW;
    }
    bool waits = limits->pose_wait_s < REAL(0.0) || seconds_since(self->started_ns, now_ns) < limits->pose_wait_s;
    if (!posed && waits) {
        return CHECK_NO_POSE;
    }
    int64_t pose_ns = self->pose_count ? self->poses[(self->pose_count - 1) % POSES_JUDGED].arrival_ns : NEVER_NS;
    if (!limits->needs_pose || seconds_since(pose_ns, now_ns) > limits->pose_stale_s) {
        return CHECK_PASSED; /* old poses are not judged: the supervisor wants a fresh one */
    }
    return judge_poses(self);
}

const char *arming_check_text(ArmingCheck check) {
    static const char *const texts[] = {
        "checks passed",
        "dmrac mambo check has not passed with these settings",
        "the flight was ended from outside",
        "calls and sensors are not judged yet",
        "the firmware calls at a wrong rate",
        "a gap between two calls of the firmware",
        "the library takes too long",
        "the acquisition repeats: sensors frozen",
        "an axis of the IMU never changes",
        "the accelerometer does not give 1 g at rest",
        "gravity is not on body z: axes swapped, or the vehicle lies on its side",
        "accelerometer z has the wrong sign, or the vehicle is upside down",
        "a rate at rest: the vehicle moves, or wrong bias or unit",
        "no optical flow",
        "waiting for the first pose",
        "poses come too slowly",
        "pose and IMU disagree about the tilt",
        "the pose's zero is not the floor",
    };
    return texts[check];
}
