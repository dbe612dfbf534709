/* Estimates position, velocity and attitude from IMU, relayed pose, optical flow, ultrasonic range and pressure. The twin
 * of onboard/estimation/estimator.py, which explains it. */
#ifndef DMRAC_ESTIMATOR_H
#define DMRAC_ESTIMATOR_H

#include "estimation/calibration.h"
#include "estimation/imu_conditioning.h"
#include "estimation/pose_fusion.h"

/* Readings must come in the order of their arrival. */
typedef struct {
    VehicleState state; /* after the newest reading */
    EstimatorConfig config;
    ErrorStateFilter filter;
    Corrections corrections;
    StuckGyro gyro;
    PoseFusion poses;
    BenchCalibration calibration; /* `refusal` is why the vehicle must not be armed yet */
    StillStart start;
    VibrationMeter vibration;
    int64_t aid_fresh_ns;
    int64_t recovery_ns;
    real bias_before[3];
    bool on_ground;
    bool at_rest;
    int32_t turn;
    real pressure_sum;
    int32_t pressure_count;
    real pressure_zero_pa;
    int64_t imu_out_of_order;
    int64_t imu_gaps;
} Estimator;

void estimator_init(Estimator *self, const EstimatorConfig *config);

/* Whether all numbers are finite. If not, the state must not be used any more. */
bool estimator_healthy(const Estimator *self);

/* Whether the vehicle is on the floor. There its velocity and height are known. `at_rest`: its motors are off as well, and
 * have been for a while; then its IMU is calibrated. */
void estimator_set_on_ground(Estimator *self, bool on_ground, bool at_rest);

/* Angular acceleration by the motors over the last `dt`, and the rest of it, rad/s^2, body FRD. */
void estimator_expect_turn(Estimator *self, const real u_hat[3], const real residual[3], real dt);

void estimator_receive_imu(Estimator *self, const ImuReading *reading);
void estimator_receive_flow(Estimator *self, const FlowReading *reading);
void estimator_receive_range(Estimator *self, const RangeReading *reading);

/* Fuse a pose of the motion capture that was true at `capture_ns` (onboard clock) and arrived at `now_ns`. `time_sigma_s`:
 * standard deviation of `capture_ns`, s, if it is more than the configured one. */
void estimator_receive_pose(Estimator *self, const Pose *pose, int64_t capture_ns, int64_t now_ns, real time_sigma_s);

/* Copy the events since the last call and forget them; returns their number. */
int32_t estimator_take_events(Estimator *self, EstimatorEvent *events);

#endif
