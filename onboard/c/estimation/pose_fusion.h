/* Fuses the poses of the motion capture: position and attitude as of their capture time. The twin of
 * onboard/estimation/pose_fusion.py, which explains it. */
#ifndef DMRAC_POSE_FUSION_H
#define DMRAC_POSE_FUSION_H

#include "estimation/corrections.h"
#include "estimation/pose_trust.h"
#include "estimation/stuck_gyro.h"

/* Decides which poses are used, and corrects the filter. */
typedef struct {
    EstimatorConfig config;
    int64_t delay_max_ns;
    int64_t last_capture_ns;
    int32_t refused_in_a_row;
    real refused_position[3];
    bool had_pose;
    PoseTrust trust;
    int64_t out_of_order;
    int64_t wrong_time;
    int64_t used;
    int64_t refused;
    int64_t attitude_refused;
    int64_t jumps;
    int64_t implausible;
    int64_t drifts;
} PoseFusion;

/* What a pose may change, and what it is compared with. */
typedef struct {
    ErrorStateFilter *filter;
    VehicleState *state;
    Corrections *corrections;
    const StuckGyro *gyro;
} PoseSurroundings;

void pose_fusion_init(PoseFusion *self, const EstimatorConfig *config);

/* A pose that was true at `capture_ns` (onboard clock, standard deviation `time_sigma_s`) and arrived at `now_ns`. */
void pose_fusion_receive(PoseFusion *self, const PoseSurroundings *at, const Pose *pose, int64_t capture_ns,
                         int64_t now_ns, real time_sigma_s);

/* After a residual of flow or range: undo what drifting poses have done to the estimate. */
void pose_fusion_check_drift(PoseFusion *self, const PoseSurroundings *at, int64_t now_ns);

#endif
