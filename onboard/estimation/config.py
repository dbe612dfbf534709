"""Settings of the estimator: sensor noise, gates and times."""

from typing import Final

from pydantic import Field

from configs.loader import ConfigRecord

GYRO_BIAS_MAX_RAD_S: Final = 0.15
"""Real vehicles of the family have up to 0.09."""


class EstimatorConfig(ConfigRecord):
    """Sigmas are standard deviations. The defaults fit the simulated sensors in flight: `dmrac bench sensors`."""

    accelerometer_sigma: float = Field(
        default=0.1, gt=0, description="m/s^2 per sample, motors off; grows with vibration"
    )
    accelerometer_sigma_max: float = Field(default=3.0, gt=0, description="m/s^2, limit of that growth")
    vibration_to_sigma: float = Field(default=0.03, ge=0, description="1; accelerometer sigma per vibration level")
    vibration_white_max_m_s2: float = Field(
        default=4.0, gt=0, description="m/s^2; above it, poses that disagree mean a wrong velocity"
    )
    gyro_sigma: float = Field(default=0.01, gt=0, description="rad/s per sample, in flight")
    gyro_bias_walk: float = Field(default=1e-3, gt=0, description="rad/s/sqrt(s)")
    accelerometer_bias_walk: float = Field(default=5e-3, gt=0, description="m/s^2/sqrt(s)")
    gyro_delay_s: float = Field(default=0.005, ge=0, le=0.05, description="s; age of the rates at their time stamp")
    gyro_stuck_samples: int = Field(
        default=6, ge=0, le=12, description="equal samples of one axis in flight that mean stuck; 0: never"
    )
    gyro_stuck_walk: float = Field(default=0.5, gt=0, description="rad/s/sqrt(s), error of the rate that replaces it")
    gyro_stuck_disturbance_s: float = Field(default=0.1, gt=0, description="s, filter of that rate's disturbance")

    start_samples: int = Field(default=50, ge=10, le=2000, description="still IMU samples needed for the start")
    start_rate_max_rad_s: float = Field(default=0.3, gt=0, description="rad/s; a faster vehicle is not still")
    start_tilt_sigma_rad: float = Field(default=0.05, gt=0, description="rad, from accelerometer bias")
    start_yaw_sigma_rad: float = Field(default=0.05, gt=0, description="rad; without pose the start defines north")
    start_gyro_bias_sigma: float = Field(default=0.02, gt=0, description="rad/s")
    start_accelerometer_bias_sigma: float = Field(default=0.35, gt=0, description="m/s^2")
    start_position_sigma_m: float = Field(
        default=0.02, gt=0, description="m; without pose the start defines the origin"
    )

    calibration_s: float = Field(
        default=2.0, ge=0, le=60, description="s at rest that arming waits for, in steps of 0.5; 0: no calibration"
    )
    calibration_force_max_m_s2: float = Field(
        default=0.25, gt=0, description="m/s^2, per axis, of a mean over 0.5 s; a larger change means a movement"
    )
    calibration_rate_max_rad_s: float = Field(default=0.02, gt=0, description="rad/s, the same for the rates")
    calibration_bias_max_rad_s: float = Field(
        default=GYRO_BIAS_MAX_RAD_S, gt=0, description="rad/s, per axis; no arming with a larger gyroscope bias"
    )

    pose_position_sigma_m: float = Field(default=0.0005, gt=0, description="m, per axis")
    pose_attitude_sigma_rad: float = Field(default=0.005, gt=0, description="rad, per axis")
    pose_time_sigma_s: float = Field(default=0.0003, ge=0, description="s, error of the capture time")
    pose_gate: float = Field(default=25.0, gt=0, description="chi-square limit, 3 degrees of freedom")
    pose_turn_time_sigma_s: float = Field(default=0.003, ge=0, description="s, the same for the attitude")
    pose_time_error_max_s: float = Field(
        default=0.1, ge=0, description="s; an attitude that such an error of the capture time explains is left out"
    )
    pose_near_m: float = Field(default=0.1, ge=0, description="m; a pose off by less gets less weight, no refusal")
    pose_near_rad: float = Field(default=0.2, ge=0, description="rad; a pose off by less gets less weight, no refusal")
    pose_delay_max_s: float = Field(default=0.4, gt=0, le=0.6, description="s; older poses are refused")
    pose_reset_count: int = Field(default=5, ge=2, description="refused poses in a row that agree: state jumps to them")
    pose_agree_m: float = Field(default=0.2, gt=0, description="m between successive refused poses that agree")
    pose_jump_m: float = Field(
        default=0.25, gt=0, description="m in flight; a pose off by more is implausible; less than pose_drift_m"
    )
    pose_jump_rate_m_s: float = Field(
        default=0.3, ge=0, description="m/s without a pose, with flow, by which that limit grows"
    )
    pose_blind_rate_m_s: float = Field(default=3.0, ge=0, description="m/s, the same without flow")
    pose_turn_max_rad: float = Field(default=0.6, gt=0, description="rad in flight; an attitude off by more, the same")
    pose_drift_m: float = Field(
        default=0.3, gt=0, description="m by which poses may lead the estimate away from flow, or range and pressure"
    )
    pose_drift_average_s: float = Field(default=2.0, gt=0, description="s over which the flow is summed up for that")
    jump_threshold_m: float = Field(default=0.05, gt=0, description="m; a larger correction is announced as a jump")

    flow_rate_sigma_rad_s: float = Field(default=0.08, gt=0, description="rad/s, per axis, of the flow rate")
    flow_scale_sigma: float = Field(default=0.02, ge=0, description="1; relative error of the flow velocity")
    flow_quality_min: int = Field(default=30, ge=0, le=255, description="flow of lower quality is ignored")
    flow_height_min_m: float = Field(default=0.12, gt=0, description="m; flow below this height is ignored")
    flow_gate: float = Field(default=12.0, gt=0, description="chi-square limit, 1 degree of freedom")

    range_sigma_m: float = Field(default=0.021, gt=0, description="m")
    range_floor_m: float = Field(default=0.44, gt=0, description="m; least distance of the ultrasonic sensor")
    range_margin_m: float = Field(default=0.04, ge=0, description="m above that distance, from which readings count")
    range_max_m: float = Field(default=4.0, gt=0, description="m")
    range_half_cone_rad: float = Field(default=0.35, ge=0, lt=1.5, description="rad; half the beam's opening angle")
    range_gate: float = Field(default=12.0, gt=0, description="chi-square limit, 1 degree of freedom")

    pressure_sigma_pa: float = Field(default=0.75, gt=0, description="Pa, of a mean of eight samples")
    pressure_drift_pa: float = Field(default=4.0, ge=0, description="Pa, drift within a flight")
    pressure_gate: float = Field(default=25.0, gt=0, description="chi-square limit, 1 degree of freedom")

    still_velocity_sigma_m_s: float = Field(default=0.05, gt=0, description="m/s on the ground")
    still_height_sigma_m: float = Field(default=0.03, gt=0, description="m on the ground, without a pose")
    unaided_velocity_sigma_m_s: float = Field(default=2.0, gt=0, description="m/s; assumed without any aid")
    recovery_s: float = Field(default=1.0, gt=0, description="s of refused aids after which the uncertainty grows")
    aid_fresh_s: float = Field(default=0.5, gt=0, description="s; a younger aid counts as present")
    covariance_every: int = Field(default=2, ge=1, le=8, description="IMU samples per covariance step")
    gap_s: float = Field(default=0.05, gt=0, description="s; after a longer IMU gap the uncertainty grows")
