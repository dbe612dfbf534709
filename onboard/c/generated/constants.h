/* Written by python -m onboard.c.generate. Do not edit. */
#ifndef DMRAC_CONSTANTS_H
#define DMRAC_CONSTANTS_H

#include <stdint.h>

#include "numerics/real.h"

#define GRAVITY REAL(9.80665) /* protocol.conventions */
#define NEVER_NS INT64_C(-1000000000000000000) /* protocol.conventions */
#define LAYERS_MAX 4 /* protocol.feature_set */
#define WIDTH_MAX 128 /* protocol.feature_set */
#define FEATURE_SET_MAX_BYTES 70400 /* protocol.feature_codec */
#define FEATURE_SET_FORMAT 1 /* protocol.feature_codec */
#define NAME_MAX_BYTES 32 /* protocol.feature_codec */
#define CATCH_UP_MAX 20 /* onboard.control.actuators */
#define ADAPT_HEIGHT_M REAL(0.2) /* onboard.flight.adaptation_gate */
#define ADAPT_CLIMB_M REAL(0.05) /* onboard.flight.adaptation_gate */
#define VELOCITY_AID_MAX_S REAL(0.3) /* onboard.flight.adaptation_gate */
#define YAW_ERROR_MAX_RAD REAL(0.5) /* onboard.control.cascade */
#define MODEL_ERROR_MAX_RAD REAL(0.6) /* onboard.control.cascade */
#define MODEL_GAP_MAX_S REAL(0.02) /* onboard.control.cascade */
#define COMMAND_JUMP_RAD REAL(0.2) /* onboard.control.command_motion */
#define FALL_MIN_M_S2 REAL(2.0) /* onboard.control.demand_limits */
#define ASTRAY_COSINE_0 REAL(0.96) /* onboard.control.demand_limits */
#define ASTRAY_COSINE_1 REAL(0.9) /* onboard.control.demand_limits */
#define UPRIGHT_MIN REAL(0.5) /* onboard.control.demand_limits */
#define RBF_COUNT 20 /* onboard.control.features */
#define INPUT_LIMIT REAL(3.0) /* onboard.control.features */
#define PROJECTION_MARGIN REAL(0.1) /* onboard.control.laws.last_layer */
#define SQUARE_MAX REAL(1e+30) /* onboard.control.laws.last_layer */
#define EPS_1_MEMORY_S REAL(2.0) /* onboard.control.laws.adaptive */
#define SKILL_SLOW_S REAL(0.3) /* onboard.control.laws.forecast_skill */
#define SKILL_MEMORY_S REAL(20.0) /* onboard.control.laws.forecast_skill */
#define MULTIPLIER_STEPS 8 /* onboard.control.laws.kalman_state */
#define MULTIPLIER_TOLERANCE REAL(1e-09) /* onboard.control.laws.kalman_state */
#define SLOPE_PERIOD_TICKS 4 /* onboard.control.laws.slope_bound */
#define BOUND_RESIDUAL_FILTER_S REAL(0.02) /* onboard.control.tracking_bound */
#define ESTIMATE_SIGMAS REAL(2.0) /* onboard.control.tracking_bound */
#define SPREAD REAL(0.9) /* onboard.control.tracking_bound */
#define OVERSHOOT REAL(1.28) /* onboard.control.tracking_bound */
#define STATES_PER_PART 5 /* onboard.control.posterior_swap */
#define SLOPES_PER_PART 1 /* onboard.control.posterior_swap */
#define UPDATES_PER_PART 3 /* onboard.control.posterior_swap */
#define SLOPE_STRIDE 4 /* onboard.control.posterior_swap */
#define FOLLOWED_MAX 64 /* onboard.control.posterior_swap */
#define BOX_SLOPES_PER_PART 1 /* onboard.control.version_test */
#define AHEAD_PER_PART 4 /* onboard.control.version_test */
#define CHECKED_PER_PART 3 /* onboard.control.version_test */
#define BOX_POINTS 32 /* onboard.control.version_test */
#define BOX_AXES 15 /* onboard.control.version_test */
#define PATH_POINTS 16 /* onboard.control.version_test */
#define STEP_MIN_M REAL(0.03) /* onboard.control.version_test */
#define WATCH_STRIDE 4 /* onboard.control.watch */
#define LOSES_S REAL(0.3) /* onboard.control.guard */
#define RETURN_M_S2 REAL(2.0) /* onboard.flight.guidance */
#define TURN_STEP_S REAL(0.04) /* onboard.flight.path_turn */
#define LEVEL_MAX_RAD REAL(0.35) /* onboard.flight.supervisor */
#define COMMAND_QUEUE_MAX 8 /* onboard.flight.supervisor */
#define PROGRESS_M REAL(0.05) /* onboard.flight.supervisor */
#define NOT_READY_NS 2000000000 /* onboard.flight.supervisor */
#define HISTORY_LENGTH 128 /* onboard.estimation.state_history */
#define POSITION 0 /* onboard.estimation.error_state_filter */
#define VELOCITY 3 /* onboard.estimation.error_state_filter */
#define ATTITUDE 6 /* onboard.estimation.error_state_filter */
#define GYRO_BIAS 9 /* onboard.estimation.error_state_filter */
#define ACCELEROMETER_BIAS 12 /* onboard.estimation.error_state_filter */
#define ERROR_SIZE 15 /* onboard.estimation.error_state_filter */
#define VIBRATION_CORNER REAL(0.2) /* onboard.estimation.imu_conditioning */
#define VIBRATION_SMOOTHING_S REAL(0.15) /* onboard.estimation.imu_conditioning */
#define FORCE_ERROR_MAX REAL(3.0) /* onboard.estimation.imu_conditioning */
#define GYRO_KEPT 64 /* onboard.estimation.stuck_gyro */
#define PER_REPEAT 3 /* onboard.estimation.stuck_gyro */
#define REPEATS_ALLOWED 16 /* onboard.estimation.stuck_gyro */
#define CALIBRATION_BLOCK_S REAL(0.5) /* onboard.estimation.calibration */
#define CALIBRATION_LEAST_SAMPLES 20 /* onboard.estimation.calibration */
#define REFUSED_MIN 8 /* onboard.estimation.corrections */
#define ESTIMATOR_EVENTS_MAX 64 /* onboard.estimation.corrections */
#define FUTURE_NS 20000000 /* onboard.estimation.pose_fusion */
#define WRONG_FOR_S REAL(0.02) /* onboard.estimation.pose_fusion */
#define LARGE_TURN_RAD REAL(0.2) /* onboard.estimation.pose_fusion */
#define DRIFT_VELOCITY_SIGMA REAL(0.2) /* onboard.estimation.pose_fusion */
#define DRIFT_HEIGHT_SIGMA REAL(0.1) /* onboard.estimation.pose_fusion */
#define DRIFT_CLIMB_SIGMA REAL(0.3) /* onboard.estimation.pose_fusion */
#define SLOW_S REAL(0.2) /* onboard.estimation.pose_trust */
#define FAST_S REAL(0.1) /* onboard.estimation.pose_trust */
#define RANGE_STEP_MAX_M REAL(0.3) /* onboard.estimation.pose_trust */
#define PRESSURE_SHARE REAL(0.6) /* onboard.estimation.pose_trust */
#define TURN_RATE_RAD_S REAL(0.02) /* onboard.estimation.pose_trust */
#define STEP_MAX_S REAL(0.1) /* onboard.estimation.pose_trust */
#define AIR_PA_PER_M REAL(11.6) /* onboard.estimation.estimator */
#define SLOW_AIDS 8 /* onboard.estimation.estimator */
#define PRESSURE_TURN 7 /* onboard.estimation.estimator */
#define COS_TILT_MIN REAL(0.7) /* onboard.estimation.estimator */
#define RATE_SIGMA REAL(0.3) /* onboard.estimation.estimator */
#define TURN_SIGMA REAL(0.03) /* onboard.estimation.estimator */
#define GAP_MAX_S REAL(0.1) /* onboard.estimation.estimator */
#define THRUST_FILTER_S REAL(0.15) /* onboard.sampling.signal_vector */
#define TICK_POSITION_AT 54 /* onboard.record.tick */
#define TICK_ATTITUDE_AT 83 /* onboard.record.tick */
#define DATAGRAM_MAX_BYTES 1200 /* protocol.messages */
#define SAMPLES_PER_BATCH_MAX 8 /* protocol.messages */
#define CHUNK_DATA_MAX_BYTES 1100 /* protocol.messages */
#define CHUNK_COUNT_MAX 64 /* protocol.messages */
#define DIGEST_BYTES 16 /* protocol.messages */
#define LAYOUT_BYTES 8 /* protocol.messages */
#define ABSOLUTE_VALUE_MAX REAL(1000000.0) /* protocol.messages */
#define COUNTER_MAX INT64_C(9223372036854775807) /* protocol.messages */
#define VERSION_MAX 1000000 /* protocol.messages */
#define MODES 11 /* protocol.messages */
#define APART_MAX_NS INT64_C(600000000000) /* protocol.messages */
#define MAC_BYTES 16 /* protocol.authentication */
#define KEY_MIN_BYTES 16 /* protocol.authentication */
#define KEY_MAX_BYTES 64 /* protocol.authentication */
#define PROTOCOL_VERSION 2 /* protocol.codec */
#define FIELDS_MAX 12 /* protocol.codec */
#define REPLAY_WINDOW 256 /* protocol.session */
#define RETIRED_MAX 256 /* protocol.session */
#define SEQUENCE_JUMP_MAX INT64_C(4294967296) /* protocol.session */
#define SILENCE_BEFORE_OLDER_NS 1000000000 /* protocol.session */
#define OPEN_REQUESTS_MAX 16 /* protocol.clock */
#define CLOCK_SAMPLES_MAX 16 /* protocol.clock */
#define REQUEST_LIFE_NS 2000000000 /* protocol.clock */
#define JUMP_SLACK_NS 5000000 /* protocol.clock */
#define CLOCK_WINDOW_NS 2000000000 /* protocol.clock_map */
#define CLOCK_BUCKET_NS 250000000 /* protocol.clock_map */
#define AHEAD_NS 20000000 /* protocol.clock_map */
#define DATAGRAM_MIN_BYTES 46 /* protocol.endpoint */
#define BODY_MAX_BYTES 1156 /* protocol.endpoint */
#define CHALLENGE_PERIOD_NS 500000000 /* protocol.endpoint */
#define RATE_MAX_HZ 2000 /* protocol.endpoint */
#define RATE_BURST 256 /* protocol.endpoint */
#define PEER_AHEAD_MAX_NS INT64_C(86400000000000) /* protocol.endpoint */
#define LOSS_WINDOW_NS 1000000000 /* onboard.links.loss_rate */
#define QUEUEING_NS 50000000 /* onboard.links.loss_rate */
#define SILENT_NS INT64_C(5000000000) /* onboard.links.loss_rate */
#define CLOCK_RECORD_PERIOD_NS 1000000000 /* onboard.links.offboard */
#define AGE_MAX_MS 2147483647 /* onboard.links.offboard */
#define GOOD_ROUND_TRIP_NS 40000000 /* onboard.links.offboard */
#define ROUND_TRIP_TO_SIGMA REAL(0.1) /* onboard.links.offboard */
#define SAMPLE_BYTES 132 /* onboard.sampling.sampler */
#define NETWORK_BYTES 28 /* onboard.sampling.sampler */
#define BATCH_OVERHEAD_BYTES 116 /* onboard.sampling.sampler */
#define BURST_BYTES REAL(2344.0) /* onboard.sampling.sampler */
#define RING_MAX 200 /* SwapConfig.ring_size */
#define KEPT_SAMPLES_MAX 1024 /* SamplerConfig.kept_samples */
#define BINS_MAX 2000 /* LapConfig.bins */
#define SIGNAL_NAMES "position_n", "position_e", "position_d", "velocity_n", "velocity_e", "velocity_d", "roll", "pitch", "yaw", "rate_p", "rate_q", "rate_r", "body_velocity_x", "body_velocity_y", "body_velocity_z", "motor_thrust_1", "motor_thrust_2", "motor_thrust_3", "motor_thrust_4", "battery_voltage", "vibration" /* protocol.signals */
#define REFUSAL_COUNT 17
#define REJECTION_COUNT 17
#define SIGNAL_COUNT 21

typedef enum {
    REFUSAL_NONE = 0,
    REFUSAL_UNDECODABLE = 1,
    REFUSAL_DIGEST = 2,
    REFUSAL_INPUTS = 3,
    REFUSAL_NOT_FINITE = 4,
    REFUSAL_LIPSCHITZ = 5,
    REFUSAL_WEIGHT_NORM = 6,
    REFUSAL_SWAP_JUMP = 7,
    REFUSAL_STALE = 8,
    REFUSAL_NOT_ACCEPTING = 9,
    REFUSAL_MISFIT = 10,
    REFUSAL_REACH = 11,
    REFUSAL_SLOPE = 12,
    REFUSAL_SWAP_RATE = 13,
    REFUSAL_PROBATION = 14,
    REFUSAL_TAKEN_BACK = 15,
    REFUSAL_NOT_TRUSTED = 16
} Refusal;

typedef enum {
    REJECTED_NONE = 0,
    REJECTED_LENGTH = 1,
    REJECTED_VERSION = 2,
    REJECTED_TYPE = 3,
    REJECTED_VEHICLE = 4,
    REJECTED_MAC = 5,
    REJECTED_SESSION = 6,
    REJECTED_DUPLICATE = 7,
    REJECTED_TOO_OLD = 8,
    REJECTED_SEQUENCE = 9,
    REJECTED_RATE = 10,
    REJECTED_BODY = 11,
    REJECTED_VALUE = 12,
    REJECTED_LAYOUT = 13,
    REJECTED_BEFORE_START = 14,
    REJECTED_TIME_SYNC = 15,
    REJECTED_NOT_ALIVE = 16
} Rejection;

typedef enum {
    SIGNAL_POSITION_N = 0,
    SIGNAL_POSITION_E = 1,
    SIGNAL_POSITION_D = 2,
    SIGNAL_VELOCITY_N = 3,
    SIGNAL_VELOCITY_E = 4,
    SIGNAL_VELOCITY_D = 5,
    SIGNAL_ROLL = 6,
    SIGNAL_PITCH = 7,
    SIGNAL_YAW = 8,
    SIGNAL_RATE_P = 9,
    SIGNAL_RATE_Q = 10,
    SIGNAL_RATE_R = 11,
    SIGNAL_BODY_VELOCITY_X = 12,
    SIGNAL_BODY_VELOCITY_Y = 13,
    SIGNAL_BODY_VELOCITY_Z = 14,
    SIGNAL_MOTOR_THRUST_1 = 15,
    SIGNAL_MOTOR_THRUST_2 = 16,
    SIGNAL_MOTOR_THRUST_3 = 17,
    SIGNAL_MOTOR_THRUST_4 = 18,
    SIGNAL_BATTERY_VOLTAGE = 19,
    SIGNAL_VIBRATION = 20
} Signal;

#endif
