/* Written by python -m onboard.c.generate. Do not edit. */
#include "generated/config.h"

#include <string.h>

typedef struct {
    const uint8_t *at;
    bool bad; /* a count or a choice is out of its range */
} Cursor;

static uint64_t read_bits(Cursor *from) {
    uint64_t bits = 0;
    for (int i = 7; i >= 0; i--) {
        bits = bits << 8 | from->at[i];
    }
    from->at += 8;
    return bits;
}

static real read_real(Cursor *from) {
    uint64_t bits = read_bits(from);
    double value;
    memcpy(&value, &bits, sizeof value);
    return (real)value;
}

static int64_t read_int(Cursor *from) {
    uint64_t bits = read_bits(from);
    int64_t value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

/* A whole number from 0 to `most`. */
static int32_t read_choice(Cursor *from, int32_t most) {
    int64_t value = read_int(from);
    if (value < 0 || value > most) {
        from->bad = true;
        return 0;
    }
    return (int32_t)value;
}

static void read_AirframeConfig(Cursor *from, AirframeConfig *out) {
    out->mass_kg = read_real(from);
    for (int i = 0; i < 3; i++) {
        out->inertia_kg_m2[i] = read_real(from);
    }
    out->arm_x_m = read_real(from);
    out->arm_y_m = read_real(from);
    out->yaw_torque_per_thrust_m = read_real(from);
    out->motor_thrust_max_n = read_real(from);
    out->motor_thrust_min_share = read_real(from);
    out->motor_lag_up_s = read_real(from);
    out->motor_lag_down_s = read_real(from);
    out->motor_response_s = read_real(from);
}

static void read_ThrustScaleConfig(Cursor *from, ThrustScaleConfig *out) {
    out->enabled = read_int(from) != 0;
    out->time_constant_s = read_real(from);
    out->start_time_constant_s = read_real(from);
    out->least = read_real(from);
    out->greatest = read_real(from);
    out->thrust_min_share = read_real(from);
}

static void read_EstimatorConfig(Cursor *from, EstimatorConfig *out) {
    out->accelerometer_sigma = read_real(from);
    out->accelerometer_sigma_max = read_real(from);
    out->vibration_to_sigma = read_real(from);
    out->vibration_white_max_m_s2 = read_real(from);
    out->gyro_sigma = read_real(from);
    out->gyro_bias_walk = read_real(from);
    out->accelerometer_bias_walk = read_real(from);
    out->gyro_delay_s = read_real(from);
    out->gyro_stuck_samples = (int32_t)read_int(from);
    out->gyro_stuck_walk = read_real(from);
    out->gyro_stuck_disturbance_s = read_real(from);
    out->start_samples = (int32_t)read_int(from);
    out->start_rate_max_rad_s = read_real(from);
    out->start_tilt_sigma_rad = read_real(from);
    out->start_yaw_sigma_rad = read_real(from);
    out->start_gyro_bias_sigma = read_real(from);
    out->start_accelerometer_bias_sigma = read_real(from);
    out->start_position_sigma_m = read_real(from);
    out->calibration_s = read_real(from);
    out->calibration_force_max_m_s2 = read_real(from);
    out->calibration_rate_max_rad_s = read_real(from);
    out->calibration_bias_max_rad_s = read_real(from);
    out->pose_position_sigma_m = read_real(from);
    out->pose_attitude_sigma_rad = read_real(from);
    out->pose_time_sigma_s = read_real(from);
    out->pose_gate = read_real(from);
    out->pose_turn_time_sigma_s = read_real(from);
    out->pose_time_error_max_s = read_real(from);
    out->pose_near_m = read_real(from);
    out->pose_near_rad = read_real(from);
    out->pose_delay_max_s = read_real(from);
    out->pose_reset_count = (int32_t)read_int(from);
    out->pose_agree_m = read_real(from);
    out->pose_jump_m = read_real(from);
    out->pose_jump_rate_m_s = read_real(from);
    out->pose_blind_rate_m_s = read_real(from);
    out->pose_turn_max_rad = read_real(from);
    out->pose_drift_m = read_real(from);
    out->pose_drift_average_s = read_real(from);
    out->jump_threshold_m = read_real(from);
    out->flow_rate_sigma_rad_s = read_real(from);
    out->flow_scale_sigma = read_real(from);
    out->flow_quality_min = (int32_t)read_int(from);
    out->flow_height_min_m = read_real(from);
    out->flow_gate = read_real(from);
    out->range_sigma_m = read_real(from);
    out->range_floor_m = read_real(from);
    out->range_margin_m = read_real(from);
    out->range_max_m = read_real(from);
    out->range_half_cone_rad = read_real(from);
    out->range_gate = read_real(from);
    out->pressure_sigma_pa = read_real(from);
    out->pressure_drift_pa = read_real(from);
    out->pressure_gate = read_real(from);
    out->still_velocity_sigma_m_s = read_real(from);
    out->still_height_sigma_m = read_real(from);
    out->unaided_velocity_sigma_m_s = read_real(from);
    out->recovery_s = read_real(from);
    out->aid_fresh_s = read_real(from);
    out->covariance_every = (int32_t)read_int(from);
    out->gap_s = read_real(from);
}

static void read_SupervisorConfig(Cursor *from, SupervisorConfig *out) {
    out->imu_silent_s = read_real(from);
    out->pose_stale_s = read_real(from);
    out->on_pose_stale = (SupervisorOnPoseStale)read_choice(from, 1);
    out->position_sigma_max_m = read_real(from);
    out->velocity_stale_s = read_real(from);
    out->velocity_lost_s = read_real(from);
    out->offboard_silent_s = read_real(from);
    out->ground_silent_s = read_real(from);
    out->battery_silent_s = read_real(from);
    out->battery_low_v = read_real(from);
    out->battery_low_remaining = read_real(from);
    out->battery_low_for_s = read_real(from);
    out->battery_arm_v = read_real(from);
    out->battery_max_v = read_real(from);
    out->tilt_max_rad = read_real(from);
    out->fence_m = read_real(from);
    out->ceiling_m = read_real(from);
    out->take_off_height_m = read_real(from);
    out->take_off_tolerance_m = read_real(from);
    out->take_off_max_s = read_real(from);
    out->armed_max_s = read_real(from);
    out->hold_max_s = read_real(from);
    out->level_max_s = read_real(from);
    out->landing_max_s = read_real(from);
    out->landed_s = read_real(from);
    out->touch_down_height_m = read_real(from);
    out->touch_down_speed_m_s = read_real(from);
    out->touch_down_thrust = read_real(from);
    out->touch_down_for_s = read_real(from);
    out->healthy_for_s = read_real(from);
    out->back_for_s = read_real(from);
    out->arm_needs_pose = read_int(from) != 0;
    out->auto_arm = read_int(from) != 0;
}

static void read_Figure8(Cursor *from, Figure8 *out) {
    out->length_m = read_real(from);
    out->width_m = read_real(from);
    out->period_s = read_real(from);
    out->start_phase = read_real(from);
}

static void read_Lissajous(Cursor *from, Lissajous *out) {
    out->length_m = read_real(from);
    out->width_m = read_real(from);
    out->period_s = read_real(from);
}

static void read_Circle(Cursor *from, Circle *out) {
    out->radius_m = read_real(from);
    out->period_s = read_real(from);
    out->start_phase = read_real(from);
}

static void read_Waypoints(Cursor *from, Waypoints *out) {
    out->points_m_count = read_choice(from, POINTS_M_MAX);
    for (int i = 0; i < POINTS_M_MAX; i++) {
        for (int j = 0; j < 3; j++) {
            out->points_m[i][j] = read_real(from);
        }
    }
    out->speed_m_s = read_real(from);
    out->wait_s = read_real(from);
}

static void read_TrajectoryPath(Cursor *from, TrajectoryPath *out) {
    out->kind = (TrajectoryPathKind)read_choice(from, 4);
    read_Figure8(from, &out->figure8);
    read_Lissajous(from, &out->lissajous);
    read_Circle(from, &out->circle);
    read_Waypoints(from, &out->waypoints);
}

static void read_TrajectoryConfig(Cursor *from, TrajectoryConfig *out) {
    read_TrajectoryPath(from, &out->path);
    out->altitude_m = read_real(from);
    out->takeoff_s = read_real(from);
    out->settle_s = read_real(from);
    out->ramp_s = read_real(from);
    out->landing_speed_m_s = read_real(from);
    out->yaw_rad = read_real(from);
}

static void read_GuidanceConfig(Cursor *from, GuidanceConfig *out) {
    read_TrajectoryConfig(from, &out->trajectory);
    out->land_after_s = read_real(from);
    out->feed_forward_lead_s = read_real(from);
    out->look_ahead_s = read_real(from);
    out->attitude_look_ahead_s = read_real(from);
    out->return_speed_m_s = read_real(from);
}

static void read_ChannelGains(Cursor *from, ChannelGains *out) {
    for (int i = 0; i < 3; i++) {
        out->natural_frequency_rad_s[i] = read_real(from);
    }
    for (int i = 0; i < 3; i++) {
        out->damping[i] = read_real(from);
    }
}

static void read_IntegralConfig(Cursor *from, IntegralConfig *out) {
    for (int i = 0; i < 3; i++) {
        out->gain[i] = read_real(from);
    }
    out->limit = read_real(from);
}

static void read_L1Config(Cursor *from, L1Config *out) {
    out->predictor_pole_rad_s = read_real(from);
    out->bandwidth_rad_s = read_real(from);
    out->limit = read_real(from);
}

static void read_IndiConfig(Cursor *from, IndiConfig *out) {
    out->filter_s = read_real(from);
    out->limit = read_real(from);
}

static void read_RepetitiveConfig(Cursor *from, RepetitiveConfig *out) {
    out->filter_s = read_real(from);
    out->limit = read_real(from);
    out->bins = (int32_t)read_int(from);
    out->lead_s = read_real(from);
    out->residual_filter_s = read_real(from);
    out->learning = read_real(from);
}

static void read_IterativeLearningConfig(Cursor *from, IterativeLearningConfig *out) {
    out->filter_s = read_real(from);
    out->limit = read_real(from);
    out->bins = (int32_t)read_int(from);
    out->lead_s = read_real(from);
    out->learning = read_real(from);
    out->cutoff_hz = read_real(from);
}

static void read_AdaptationConfig(Cursor *from, AdaptationConfig *out) {
    out->tracking_gain = read_real(from);
    out->composite_gain = read_real(from);
    out->bias_weight = read_real(from);
    out->leak = read_real(from);
    out->weight_norm_max = read_real(from);
    out->normalisation_floor = read_real(from);
    out->residual_filter_s = read_real(from);
}

static void read_SlopeShares(Cursor *from, SlopeShares *out) {
    out->place = read_real(from);
    out->motion = read_real(from);
    out->turn = read_real(from);
}

static void read_KalmanConfig(Cursor *from, KalmanConfig *out) {
    out->tracking_gain = read_real(from);
    out->composite_gain = read_real(from);
    out->noise = read_real(from);
    out->prior = read_real(from);
    out->fast_bias = read_real(from);
    out->prior_rate = read_real(from);
    out->fast_bias_rate = read_real(from);
    out->weight_norm_max = read_real(from);
    out->residual_filter_s = read_real(from);
    out->confidence = read_int(from) != 0;
    out->skill = read_int(from) != 0;
    read_SlopeShares(from, &out->slope);
}

static void read_AdaptiveLaw(Cursor *from, AdaptiveLaw *out) {
    out->kind = (AdaptiveLawKind)read_choice(from, 1);
    read_AdaptationConfig(from, &out->gradient);
    read_KalmanConfig(from, &out->kalman);
}

static void read_SwapConfig(Cursor *from, SwapConfig *out) {
    out->memory_weight = read_real(from);
    out->ring_size = (int32_t)read_int(from);
    out->ring_period_ticks = (int32_t)read_int(from);
    out->jump_max = read_real(from);
    out->lipschitz_max = read_real(from);
    out->naive = read_int(from) != 0;
}

static void read_AdaptiveConfig(Cursor *from, AdaptiveConfig *out) {
    out->features = (AdaptiveFeatures)read_choice(from, 2);
    out->rbf_width = read_real(from);
    read_AdaptiveLaw(from, &out->law);
    for (int i = 0; i < 2; i++) {
        out->error_weight[i] = read_real(from);
    }
    read_SwapConfig(from, &out->swap);
}

static void read_ChannelSettingsAugmentation(Cursor *from, ChannelSettingsAugmentation *out) {
    out->kind = (ChannelSettingsAugmentationKind)read_choice(from, 6);
    read_IntegralConfig(from, &out->integral);
    read_L1Config(from, &out->l1);
    read_IndiConfig(from, &out->indi);
    read_RepetitiveConfig(from, &out->repetitive);
    read_IterativeLearningConfig(from, &out->ilc);
    read_AdaptiveConfig(from, &out->adaptive);
}

static void read_ChannelSettings(Cursor *from, ChannelSettings *out) {
    read_ChannelGains(from, &out->gains);
    read_ChannelSettingsAugmentation(from, &out->augmentation);
}

static void read_DemandLimitsConfig(Cursor *from, DemandLimitsConfig *out) {
    out->tilt_max_rad = read_real(from);
    out->climb_acceleration_max_m_s2 = read_real(from);
    out->take_off_acceleration_max_m_s2 = read_real(from);
    out->sink_acceleration_max_m_s2 = read_real(from);
    out->lack_filter_s = read_real(from);
}

static void read_RoomConfig(Cursor *from, RoomConfig *out) {
    out->enabled = read_int(from) != 0;
    for (int i = 0; i < 2; i++) {
        out->share[i] = read_real(from);
    }
    for (int i = 0; i < 2; i++) {
        out->least[i] = read_real(from);
    }
}

static void read_VersionTestConfig(Cursor *from, VersionTestConfig *out) {
    out->enabled = read_int(from) != 0;
    out->reach_s = read_real(from);
    out->check_s = read_real(from);
    out->acceleration_m_s2 = read_real(from);
    out->misfit = read_real(from);
    for (int i = 0; i < 2; i++) {
        out->misfit_floor[i] = read_real(from);
    }
    for (int i = 0; i < 2; i++) {
        out->bound_max[i] = read_real(from);
    }
    for (int i = 0; i < 2; i++) {
        out->spread_max[i] = read_real(from);
    }
    for (int i = 0; i < 2; i++) {
        out->path_slope[i] = read_real(from);
    }
    for (int i = 0; i < 2; i++) {
        out->box_slope[i] = read_real(from);
    }
}

static void read_WatchConfig(Cursor *from, WatchConfig *out) {
    out->enabled = read_int(from) != 0;
    for (int i = 0; i < 2; i++) {
        out->lag_s[i] = read_real(from);
    }
    out->average_s = read_real(from);
    out->margin = read_real(from);
    for (int i = 0; i < 2; i++) {
        out->misfit_floor[i] = read_real(from);
    }
    for (int i = 0; i < 2; i++) {
        out->error_floor[i] = read_real(from);
    }
    out->trial_s = read_real(from);
    out->trial_margin = read_real(from);
    out->worse_s = read_real(from);
    for (int i = 0; i < 2; i++) {
        out->disagreement[i] = read_real(from);
    }
    out->proof_s = read_real(from);
    out->audition_s = read_real(from);
    out->agreement_s = read_real(from);
}

static void read_GuardConfig(Cursor *from, GuardConfig *out) {
    read_RoomConfig(from, &out->room);
    read_VersionTestConfig(from, &out->test);
    read_WatchConfig(from, &out->watch);
    out->swaps_per_s_max = read_real(from);
    out->jumps_max = read_real(from);
    out->strikes_max = (int32_t)read_int(from);
    out->losses_max = (int32_t)read_int(from);
}

static void read_CascadeSettings(Cursor *from, CascadeSettings *out) {
    read_ChannelSettings(from, &out->position);
    read_ChannelSettings(from, &out->attitude);
    out->hedging = (CascadeSettingsHedging)read_choice(from, 2);
    out->position_error_max_m = read_real(from);
    read_DemandLimitsConfig(from, &out->limits);
    read_GuardConfig(from, &out->guard);
    out->prediction = read_int(from) != 0;
    out->gyro_delay_ticks = read_real(from);
    out->command_rate_filter_s = read_real(from);
    out->path_turn = read_real(from);
    out->level_sink_speed_m_s = read_real(from);
}

static void read_SamplerConfig(Cursor *from, SamplerConfig *out) {
    out->rate_hz = read_real(from);
    out->batch_samples = (int32_t)read_int(from);
    out->budget_bytes_s = read_real(from);
    out->kept_samples = (int32_t)read_int(from);
    out->repeat_from_loss = read_real(from);
    out->repeat_after_s = read_real(from);
}

static void read_Swing(Cursor *from, Swing *out) {
    out->amplitude_m = read_real(from);
    out->omega_rad_s = read_real(from);
    out->phase_rad = read_real(from);
}

static void read_CoreConfig(Cursor *from, CoreConfig *out) {
    out->vehicle_id = (int32_t)read_int(from);
    out->period_ns = read_int(from);
    out->status_period_s = read_real(from);
    out->time_sync_period_s = read_real(from);
    read_AirframeConfig(from, &out->airframe);
    read_ThrustScaleConfig(from, &out->thrust_scale);
    read_EstimatorConfig(from, &out->estimator);
    read_SupervisorConfig(from, &out->supervisor);
    read_GuidanceConfig(from, &out->guidance);
    read_CascadeSettings(from, &out->controller);
    read_SamplerConfig(from, &out->samples);
    for (int i = 0; i < 2; i++) {
        read_Swing(from, &out->lissajous[i]);
    }
    for (int i = 0; i < 8; i++) {
        out->layout[i] = (int32_t)read_int(from);
    }
}

bool config_decode(const uint8_t *packed, size_t size, CoreConfig *out) {
    static const uint8_t header[12] = {0x44, 0x4d, 0x52, 0x43, 0x31, 0x82, 0x07, 0x92, 0xf9, 0xa1, 0x8b, 0x04};
    if (size != CONFIG_IMAGE_BYTES || memcmp(packed, header, sizeof header) != 0) {
        return false;
    }
    Cursor from = {packed + sizeof header, false};
    read_CoreConfig(&from, out);
    return !from.bad;
}
