/* Written by python -m onboard.c.generate. Do not edit. */
#ifndef DMRAC_CONFIG_H
#define DMRAC_CONFIG_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "numerics/real.h"

#define CONFIG_IMAGE_BYTES 4220

/* After each member: its place within the packed record, in bytes, and its unit. */

typedef struct {
    real mass_kg; /* 0 */
    real inertia_kg_m2[3]; /* 8 */
    real arm_x_m; /* 32 */
    real arm_y_m; /* 40 */
    real yaw_torque_per_thrust_m; /* 48 */
    real motor_thrust_max_n; /* 56 */
    real motor_thrust_min_share; /* 64 */
    real motor_lag_up_s; /* 72 */
    real motor_lag_down_s; /* 80 */
    real motor_response_s; /* 88 */
} AirframeConfig;

typedef struct {
    bool enabled; /* 0: whether k is estimated and used; if not, it is 1 */
    real time_constant_s; /* 8: s, of the estimate at hover */
    real start_time_constant_s; /* 16: s, the same when it begins; at most time_constant_s */
    real least; /* 24: least k, as a multiple of the nominal thrust */
    real greatest; /* 32: greatest k */
    real thrust_min_share; /* 40: thrust below which nothing is learnt, as a share of the weight */
} ThrustScaleConfig;

typedef struct {
    real accelerometer_sigma; /* 0: m/s^2 per sample, motors off; grows with vibration */
    real accelerometer_sigma_max; /* 8: m/s^2, limit of that growth */
    real vibration_to_sigma; /* 16: 1; accelerometer sigma per vibration level */
    real vibration_white_max_m_s2; /* 24: m/s^2; above it, poses that disagree mean a wrong velocity */
    real gyro_sigma; /* 32: rad/s per sample, in flight */
    real gyro_bias_walk; /* 40: rad/s/sqrt(s) */
    real accelerometer_bias_walk; /* 48: m/s^2/sqrt(s) */
    real gyro_delay_s; /* 56: s; age of the rates at their time stamp */
    int32_t gyro_stuck_samples; /* 64: equal samples of one axis in flight that mean stuck; 0: never */
    real gyro_stuck_walk; /* 72: rad/s/sqrt(s), error of the rate that replaces it */
    real gyro_stuck_disturbance_s; /* 80: s, filter of that rate's disturbance */
    int32_t start_samples; /* 88: still IMU samples needed for the start */
    real start_rate_max_rad_s; /* 96: rad/s; a faster vehicle is not still */
    real start_tilt_sigma_rad; /* 104: rad, from accelerometer bias */
    real start_yaw_sigma_rad; /* 112: rad; without pose the start defines north */
    real start_gyro_bias_sigma; /* 120: rad/s */
    real start_accelerometer_bias_sigma; /* 128: m/s^2 */
    real start_position_sigma_m; /* 136: m; without pose the start defines the origin */
    real calibration_s; /* 144: s at rest that arming waits for, in steps of 0.5; 0: no calibration */
    real calibration_force_max_m_s2; /* 152: m/s^2, per axis, of a mean over 0.5 s; a larger change means a movement */
    real calibration_rate_max_rad_s; /* 160: rad/s, the same for the rates */
    real calibration_bias_max_rad_s; /* 168: rad/s, per axis; no arming with a larger gyroscope bias */
    real pose_position_sigma_m; /* 176: m, per axis */
    real pose_attitude_sigma_rad; /* 184: rad, per axis */
    real pose_time_sigma_s; /* 192: s, error of the capture time */
    real pose_gate; /* 200: chi-square limit, 3 degrees of freedom */
    real pose_turn_time_sigma_s; /* 208: s, the same for the attitude */
    real pose_time_error_max_s; /* 216: s; an attitude that such an error of the capture time explains is left out */
    real pose_near_m; /* 224: m; a pose off by less gets less weight, no refusal */
    real pose_near_rad; /* 232: rad; a pose off by less gets less weight, no refusal */
    real pose_delay_max_s; /* 240: s; older poses are refused */
    int32_t pose_reset_count; /* 248: refused poses in a row that agree: state jumps to them */
    real pose_agree_m; /* 256: m between successive refused poses that agree */
    real pose_jump_m; /* 264: m in flight; a pose off by more is implausible; less than pose_drift_m */
    real pose_jump_rate_m_s; /* 272: m/s without a pose, with flow, by which that limit grows */
    real pose_blind_rate_m_s; /* 280: m/s, the same without flow */
    real pose_turn_max_rad; /* 288: rad in flight; an attitude off by more, the same */
    real pose_drift_m; /* 296: m by which poses may lead the estimate away from flow, or range and pressure */
    real pose_drift_average_s; /* 304: s over which the flow is summed up for that */
    real jump_threshold_m; /* 312: m; a larger correction is announced as a jump */
    real flow_rate_sigma_rad_s; /* 320: rad/s, per axis, of the flow rate */
    real flow_scale_sigma; /* 328: 1; relative error of the flow velocity */
    int32_t flow_quality_min; /* 336: flow of lower quality is ignored */
    real flow_height_min_m; /* 344: m; flow below this height is ignored */
    real flow_gate; /* 352: chi-square limit, 1 degree of freedom */
    real range_sigma_m; /* 360: m */
    real range_floor_m; /* 368: m; least distance of the ultrasonic sensor */
    real range_margin_m; /* 376: m above that distance, from which readings count */
    real range_max_m; /* 384: m */
    real range_half_cone_rad; /* 392: rad; half the beam's opening angle */
    real range_gate; /* 400: chi-square limit, 1 degree of freedom */
    real pressure_sigma_pa; /* 408: Pa, of a mean of eight samples */
    real pressure_drift_pa; /* 416: Pa, drift within a flight */
    real pressure_gate; /* 424: chi-square limit, 1 degree of freedom */
    real still_velocity_sigma_m_s; /* 432: m/s on the ground */
    real still_height_sigma_m; /* 440: m on the ground, without a pose */
    real unaided_velocity_sigma_m_s; /* 448: m/s; assumed without any aid */
    real recovery_s; /* 456: s of refused aids after which the uncertainty grows */
    real aid_fresh_s; /* 464: s; a younger aid counts as present */
    int32_t covariance_every; /* 472: IMU samples per covariance step */
    real gap_s; /* 480: s; after a longer IMU gap the uncertainty grows */
} EstimatorConfig;

typedef enum { SUPERVISOR_ON_POSE_STALE_HOLD, SUPERVISOR_ON_POSE_STALE_CONTINUE } SupervisorOnPoseStale;

typedef struct {
    real imu_silent_s; /* 0: s; motors off */
    real pose_stale_s; /* 8: s; an older pose does not count */
    SupervisorOnPoseStale on_pose_stale; /* 16: hold: stop on flow; continue: fly on while flow and position_sigma_m are good */
    real position_sigma_max_m; /* 24: m; limit for continue */
    real velocity_stale_s; /* 32: s; an older flow does not count */
    real velocity_lost_s; /* 40: s; level and descend */
    real offboard_silent_s; /* 48: s; a message only */
    real ground_silent_s; /* 56: s; landing; 0: not needed */
    real battery_silent_s; /* 64: s; landing; 0: not needed */
    real battery_low_v; /* 72: V under load; landing */
    real battery_low_remaining; /* 80: fraction; landing */
    real battery_low_for_s; /* 88: s for which the battery must be low */
    real battery_arm_v; /* 96: V; no arming below */
    real battery_max_v; /* 104: V; no arming above: wrong unit or cell count */
    real tilt_max_rad; /* 112: rad; motors off */
    real fence_m; /* 120: m from the origin, horizontally; landing */
    real ceiling_m; /* 128: m above the floor; landing */
    real take_off_height_m; /* 136: m above the floor */
    real take_off_tolerance_m; /* 144: m below that height: take-off is complete */
    real take_off_max_s; /* 152: s; then landing */
    real armed_max_s; /* 160: s on the ground with idle motors; then disarmed */
    real hold_max_s; /* 168: s on flow alone; then landing */
    real level_max_s; /* 176: s of level descent without progress; then motors off */
    real landing_max_s; /* 184: s without getting lower; then level descent */
    real landed_s; /* 192: s after touch-down until the next flight may be prepared */
    real touch_down_height_m; /* 200: m; below it and slow is touch-down */
    real touch_down_speed_m_s; /* 208: m/s */
    real touch_down_thrust; /* 216: of weight; less and slow is touch-down too */
    real touch_down_for_s; /* 224: s for which touch-down must last */
    real healthy_for_s; /* 232: s for which all sensors must be good before arming */
    real back_for_s; /* 240: s for which a lost aid must be back */
    bool arm_needs_pose; /* 248: no arming without a fresh pose */
    bool auto_arm; /* 256: simulation only: arm and take off, once, when ready */
} SupervisorConfig;

typedef struct {
    real length_m; /* 0: north extent, tip to tip */
    real width_m; /* 8: east extent */
    real period_s; /* 16: one lap */
    real start_phase; /* 24: where on the lap the path begins, share of a lap */
} Figure8;

typedef struct {
    real length_m; /* 0: north extent, tip to tip */
    real width_m; /* 8: east extent */
    real period_s; /* 16: one lap of the figure-8 with the same RMS speed */
} Lissajous;

typedef struct {
    real radius_m; /* 0 */
    real period_s; /* 8: one lap */
    real start_phase; /* 16: where on the lap the path begins, share of a lap */
} Circle;
#define POINTS_M_MAX 64

typedef struct {
    int32_t points_m_count; /* 0 */
    real points_m[POINTS_M_MAX][3]; /* 8 */
    real speed_m_s; /* 1544: mean speed along a leg */
    real wait_s; /* 1552: rest at each point */
} Waypoints;

typedef enum { PATH_HOVER, PATH_FIGURE8, PATH_LISSAJOUS, PATH_CIRCLE, PATH_WAYPOINTS } TrajectoryPathKind;

typedef struct {
    TrajectoryPathKind kind; /* 0 */
    Figure8 figure8; /* 8 */
    Lissajous lissajous; /* 40 */
    Circle circle; /* 64 */
    Waypoints waypoints; /* 88 */
} TrajectoryPath;

typedef struct {
    TrajectoryPath path; /* 0 */
    real altitude_m; /* 1648 */
    real takeoff_s; /* 1656 */
    real settle_s; /* 1664: hover between take-off and path */
    real ramp_s; /* 1672: time in which a periodic path reaches its speed */
    real landing_speed_m_s; /* 1680 */
    real yaw_rad; /* 1688 */
} TrajectoryConfig;

typedef struct {
    TrajectoryConfig trajectory; /* 0 */
    real land_after_s; /* 1696: path time at which the landing begins */
    real feed_forward_lead_s; /* 1704: t_ff: lag of the inner loops; below 0 where they lead */
    real look_ahead_s; /* 1712: t_ahead of the position channel's features */
    real attitude_look_ahead_s; /* 1720: t_ahead of the attitude channel's */
    real return_speed_m_s; /* 1728: m/s, back to the path after a jump */
} GuidanceConfig;

typedef struct {
    real natural_frequency_rad_s[3]; /* 0 */
    real damping[3]; /* 24 */
} ChannelGains;

typedef struct {
    real gain[3]; /* 0 */
    real limit; /* 24: bound on each axis of nu_ad, units of u */
} IntegralConfig;

typedef struct {
    real predictor_pole_rad_s; /* 0: -A_s of the state predictor */
    real bandwidth_rad_s; /* 8: of the low-pass filter C(s) */
    real limit; /* 16: bound on each axis of nu_ad, units of u */
} L1Config;

typedef struct {
    real filter_s; /* 0: time constant on x_dot and u_hat alike */
    real limit; /* 8: bound on each axis of nu_ad, units of u */
} IndiConfig;

typedef struct {
    real filter_s; /* 0: time constant on x_dot and u_hat alike */
    real limit; /* 8: bound on each axis of nu_ad, units of u */
    int32_t bins; /* 16: of lap phase */
    real lead_s; /* 24: lag of the loop, by which the table leads */
    real residual_filter_s; /* 32: time constant on the residual to be stored */
    real learning; /* 40: least share of a new lap in the table */
} RepetitiveConfig;

typedef struct {
    real filter_s; /* 0: time constant on x_dot and u_hat alike */
    real limit; /* 8: bound on each axis of nu_ad, units of u */
    int32_t bins; /* 16: of lap phase */
    real lead_s; /* 24: lag of the loop, by which the table leads */
    real learning; /* 32: share of the misfit that a lap corrects */
    real cutoff_hz; /* 40: of the smoothing filter Q */
} IterativeLearningConfig;

typedef enum { ADAPTIVE_FEATURES_NETWORK, ADAPTIVE_FEATURES_RBF, ADAPTIVE_FEATURES_BIAS } AdaptiveFeatures;

typedef struct {
    real tracking_gain; /* 0: gamma, 1/s^3: nu_ad gains so much per second and unit of e_1, first axis */
    real composite_gain; /* 8: lambda, 1/s: nu_ad approaches Delta_hat; 0 = off */
    real bias_weight; /* 16: kappa: Gamma of the bias against the others */
    real leak; /* 24: sigma, 1/s: W, the bias apart, drifts back to the trained last layer */
    real weight_norm_max; /* 32: W_max: radius of the ball W is kept in, units of u */
    real normalisation_floor; /* 40: eps in eps + Phi'Gamma Phi */
    real residual_filter_s; /* 48: time constant of Delta_hat */
} AdaptationConfig;

typedef struct {
    real place; /* 0: over the position */
    real motion; /* 8: over the velocity, also in body axes */
    real turn; /* 16: over attitude and body rates, which are read at the vehicle */
} SlopeShares;

typedef struct {
    real tracking_gain; /* 0: 1/s^3: nu_ad gains at most so much per second and unit of e_1 */
    real composite_gain; /* 8: lambda, 1/s: nu_ad follows the residual no faster than this; 0 = off */
    real noise; /* 16: sqrt(R): residual of a tick about the model, units of u */
    real prior; /* 24: p: spread of W about the trained last layer, units of u */
    real fast_bias; /* 32: sigma_b: stationary spread of b, units of u */
    real prior_rate; /* 40: s_w, 1/s: W reverts to the trained last layer */
    real fast_bias_rate; /* 48: s_b, 1/s: b reverts to zero */
    real weight_norm_max; /* 56: W_max: radius of the balls of theta and of [W - theta; b] */
    real residual_filter_s; /* 64: time constant of Delta_hat */
    bool confidence; /* 72: false: ablation, a = 1 */
    bool skill; /* 80: false: ablation, g = 1 */
    SlopeShares slope; /* 88 */
} KalmanConfig;

typedef enum { LAW_GRADIENT, LAW_KALMAN } AdaptiveLawKind;

typedef struct {
    AdaptiveLawKind kind; /* 0 */
    AdaptationConfig gradient; /* 8 */
    KalmanConfig kalman; /* 64 */
} AdaptiveLaw;

typedef struct {
    real memory_weight; /* 0: mu per recent state: pull towards W_bar */
    int32_t ring_size; /* 8: recent states kept */
    int32_t ring_period_ticks; /* 16: ticks between two of them */
    real jump_max; /* 24: largest eps_2 accepted, units of u */
    real lipschitz_max; /* 32: largest Lipschitz constant of Phi accepted */
    bool naive; /* 40: ablation: keep W as it is instead of the bumpless swap */
} SwapConfig;

typedef struct {
    AdaptiveFeatures features; /* 0 */
    real rbf_width; /* 8: width of the Gaussians, scaled units per sqrt(input) */
    AdaptiveLaw law; /* 16 */
    real error_weight[2]; /* 192 */
    SwapConfig swap; /* 208 */
} AdaptiveConfig;

typedef enum { AUGMENTATION_NONE, AUGMENTATION_INTEGRAL, AUGMENTATION_L1, AUGMENTATION_INDI, AUGMENTATION_REPETITIVE, AUGMENTATION_ILC, AUGMENTATION_ADAPTIVE } ChannelSettingsAugmentationKind;

typedef struct {
    ChannelSettingsAugmentationKind kind; /* 0 */
    IntegralConfig integral; /* 8 */
    L1Config l1; /* 40 */
    IndiConfig indi; /* 64 */
    RepetitiveConfig repetitive; /* 80 */
    IterativeLearningConfig ilc; /* 128 */
    AdaptiveConfig adaptive; /* 176 */
} ChannelSettingsAugmentation;

typedef struct {
    ChannelGains gains; /* 0 */
    ChannelSettingsAugmentation augmentation; /* 48 */
} ChannelSettings;

typedef enum { CASCADE_SETTINGS_HEDGING_ALL, CASCADE_SETTINGS_HEDGING_LIMITS, CASCADE_SETTINGS_HEDGING_NONE } CascadeSettingsHedging;

typedef struct {
    real tilt_max_rad; /* 0 */
    real climb_acceleration_max_m_s2; /* 8 */
    real take_off_acceleration_max_m_s2; /* 16: climb until the laws begin to adapt */
    real sink_acceleration_max_m_s2; /* 24 */
    real lack_filter_s; /* 32: s, time constant on the vertical residual that tells what thrust lacks */
} DemandLimitsConfig;

typedef struct {
    bool enabled; /* 0: false: ablation, nu_ad is bounded by W_max alone */
    real share[2]; /* 8: of what the loop leaves */
    real least[2]; /* 24: of the reach, whatever the loop needs */
} RoomConfig;

typedef struct {
    bool enabled; /* 0: false: ablation */
    real reach_s; /* 8: s, the box is what can be reached in this time */
    real check_s; /* 16: s, between two checks of the map that flies, on its box of then */
    real acceleration_m_s2; /* 24: m/s^2, by which the path may turn away */
    real misfit; /* 32: of the map, over the size of the residual */
    real misfit_floor[2]; /* 40: plus this, units of u */
    real bound_max[2]; /* 56: norm(theta) norm(Phi), units of u */
    real spread_max[2]; /* 72: largest change in the box, units of u */
    real path_slope[2]; /* 88: along the path, share of its limit */
    real box_slope[2]; /* 104: over the states, share of its limit */
} VersionTestConfig;

typedef struct {
    bool enabled; /* 0: false: ablation, no law is taken back in flight */
    real lag_s[2]; /* 8: s, from nu_cmd to its effect */
    real average_s; /* 24: s, of the mean squares */
    real margin; /* 32: worse: so many times the other law's */
    real misfit_floor[2]; /* 40: plus this, units of u */
    real error_floor[2]; /* 56: the same for e, units of u */
    real trial_s; /* 72: s of evidence, over which a map is compared without a floor */
    real trial_margin; /* 80: misfit of the map over that of the bias-only law, over trial_s */
    real worse_s; /* 88: s, worse for so long is taken back */
    real disagreement[2]; /* 96: above this a tick is evidence, units of u */
    real proof_s; /* 112: s of evidence after which a version is proven */
    real audition_s; /* 120: s of evidence after which a version may fly at all */
    real agreement_s; /* 128: or s in which it says what the bias says, where none has failed before */
} WatchConfig;

typedef struct {
    RoomConfig room; /* 0 */
    VersionTestConfig test; /* 40 */
    WatchConfig watch; /* 160 */
    real swaps_per_s_max; /* 296: 1/s, accepted versions */
    real jumps_max; /* 304: summed jumps of nu_cmd in a second, over jump_max of the channel */
    int32_t strikes_max; /* 312: versions taken back, after which no other is accepted */
    int32_t losses_max; /* 320: versions in a row that lost when the next came, before each is auditioned */
} GuardConfig;

typedef struct {
    ChannelSettings position; /* 0 */
    ChannelSettings attitude; /* 480 */
    CascadeSettingsHedging hedging; /* 960: what is taken out of both reference models: all that is not delivered, or what limits take */
    real position_error_max_m; /* 968 */
    DemandLimitsConfig limits; /* 976 */
    GuardConfig guard; /* 1016 */
    bool prediction; /* 1344: attitude and rates predicted over the loop's dead time */
    real gyro_delay_ticks; /* 1352: age of the rates, for the prediction */
    real command_rate_filter_s; /* 1360: of the rate that feedback adds to the command's; 0: it is not fed forward */
    real path_turn; /* 1368: share of the path's rate and acceleration of turn that is fed forward */
    real level_sink_speed_m_s; /* 1376 */
} CascadeSettings;

typedef struct {
    real rate_hz; /* 0: Hz, samples a second */
    int32_t batch_samples; /* 8: samples a datagram */
    real budget_bytes_s; /* 16: B/s up in all, UDP and IP included */
    int32_t kept_samples; /* 24: samples held while waiting */
    real repeat_from_loss; /* 32: share of offboard's datagrams lost from which batches go twice; 1: never */
    real repeat_after_s; /* 40: s to the second time; well below offboard's labels.reorder_s */
} SamplerConfig;

typedef struct {
    real amplitude_m; /* 0 */
    real omega_rad_s; /* 8 */
    real phase_rad; /* 16 */
} Swing;

typedef struct {
    int32_t vehicle_id; /* 0 */
    int64_t period_ns; /* 8: ns, one tick */
    real status_period_s; /* 16: s between two Status messages */
    real time_sync_period_s; /* 24: s between two requests */
    AirframeConfig airframe; /* 32 */
    ThrustScaleConfig thrust_scale; /* 128 */
    EstimatorConfig estimator; /* 176 */
    SupervisorConfig supervisor; /* 664 */
    GuidanceConfig guidance; /* 928 */
    CascadeSettings controller; /* 2664: of the cascade */
    SamplerConfig samples; /* 4048 */
    Swing lissajous[2]; /* 4096: north and east; zero on another path */
    int32_t layout[8]; /* 4144: bytes of feature_digest */
} CoreConfig;

/* Reads a packed image; false if it is not one of this layout, and `out` must not be used then. */
bool config_decode(const uint8_t *packed, size_t size, CoreConfig *out);

#endif
