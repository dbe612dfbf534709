"""Constants of the vehicle as typed records, with units. Values and their sources: configs/vehicles/*.yaml."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from configs.loader import ConfigRecord
from protocol.geometry import Vector3

PositiveVector3 = tuple[
    Annotated[float, Field(gt=0.0)], Annotated[float, Field(gt=0.0)], Annotated[float, Field(gt=0.0)]
]
UnitVector3 = tuple[Annotated[float, Field(ge=0.0)], Annotated[float, Field(ge=0.0)], Annotated[float, Field(ge=0.0)]]

RotorSpeed = Annotated[float, Field(ge=0.8, le=1.2)]


class BodyConfig(ConfigRecord):
    """Mass and geometry. The inertia is about the centre of mass, along the body's axes."""

    mass_kg: float = Field(gt=0.0, description="kg")
    inertia_kg_m2: PositiveVector3 = Field(description="Jxx, Jyy, Jzz, kg m^2")
    centre_of_mass_m: Vector3 = Field(description="m, body FRD, from the point half way between the rotors' axes")
    arm_x_m: float = Field(gt=0.0, description="m, forward distance of a rotor from the centre")
    arm_y_m: float = Field(gt=0.0, description="m, sideways distance of a rotor from the centre")
    rotor_height_m: float = Field(ge=0.0, lt=0.1, description="m, rotor plane above the centre")
    rotor_radius_m: float = Field(gt=0.0, description="m")


class MotorConfig(ConfigRecord):
    """Motors and rotors; thrust is linear in the command fraction."""

    max_thrust_n: float = Field(gt=0.0, description="N per motor at full command and rated voltage")
    thrust_slope_n_s2: float = Field(gt=0.0, description="N/(rad/s)^2, thrust per squared rotor speed")
    torque_ratio_m: float = Field(ge=0.0, description="m, drag torque per thrust")
    gain: tuple[float, float, float, float] = Field(description="thrust per command against max_thrust_n, PX4 order")
    lag_up_s: float = Field(gt=0.0, description="s, time constant of rising thrust")
    lag_down_s: float = Field(gt=0.0, description="s, time constant of falling thrust")
    command_min: float = Field(ge=0.0, lt=1.0, description="least fraction of an armed motor")
    command_delay_s: float = Field(ge=0.0, le=0.1, description="s from the arrival of a command to its effect")
    command_timeout_s: float = Field(gt=0.0, description="s without a command after which the motors stop")


class BatteryConfig(ConfigRecord):
    """A single lithium-polymer cell with an immediate and a slow resistance."""

    rated_v: float = Field(gt=0.0, description="V, of max_thrust_n; thrust grows with V^2")
    full_v: float = Field(gt=0.0, description="V, open circuit, full")
    empty_v: float = Field(gt=0.0, description="V, open circuit, empty")
    capacity_mah: float = Field(gt=0.0, description="mA h")
    charge_used: float = Field(ge=0.0, lt=1.0, description="fraction used at the start")
    resistance_ohm: float = Field(ge=0.0, description="ohm")
    polarisation_ohm: float = Field(ge=0.0, description="ohm, of the slow drop")
    polarisation_s: float = Field(gt=0.0, description="s, time constant of the slow drop")
    power_w_n15: float = Field(ge=0.0, description="W/N^1.5, electrical power per thrust^1.5 of a motor")
    idle_a: float = Field(ge=0.0, description="A, electronics")


class DragConfig(ConfigRecord):
    """Airframe drag, at the rotor plane, against the air: (linear + quadratic |u|) u."""

    linear_n_s_m: float = Field(ge=0.0, description="N/(m/s)")
    quadratic_n_s2_m2: float = Field(ge=0.0, description="N/(m/s)^2")


class RotorpyConfig(ConfigRecord):
    """What RotorPy's rotors have and ours do not, as ratios to their drag k_d, which `drag.linear_n_s_m` gives.

    The defaults are those of RotorPy's Hummingbird; none of RotorPy's vehicles has a flapping moment.
    """

    inflow_ratio: float = Field(default=1.95, ge=0.0, description="k_z / k_d: loss of thrust by axial air velocity")
    lift_s_m: float = Field(
        default=0.0607, ge=0.0, description="s/m, k_h / (k_d hover speed): thrust by squared air velocity in the plane"
    )
    flapping_m: float = Field(default=0.0, description="m, k_flap / k_d: moment at the hub per rotor drag")


class FloorConfig(ConfigRecord):
    """The floor at d = 0: contact at four feet and four rotor rims, and ground effect."""

    stiffness_n_m: float = Field(gt=0.0, description="N/m per contact point")
    damping_n_s_m: float = Field(ge=0.0, description="N/(m/s) per contact point")
    grip_n_s_m: float = Field(ge=0.0, description="N/(m/s) per contact point, sideways, until it slides")
    friction: float = Field(ge=0.0, description="Coulomb's coefficient")
    foot_x_m: float = Field(gt=0.0, lt=0.1, description="m")
    foot_y_m: float = Field(gt=0.0, lt=0.1, description="m")
    foot_drop_m: float = Field(gt=0.0, lt=0.1, description="m, feet below the centre")
    ground_effect: float = Field(ge=0.0, description="k of thrust factor 1 + k (R/4z)^2; 0 switches it off")


class NominalConfig(ConfigRecord):
    """The nominal vehicle: true disturbance force and torque are those that it does not explain.

    configs/vehicle.py fills it, and onboard's airframe, with the nominal values of the vehicle's file.
    """

    body: BodyConfig
    motors: MotorConfig


class MeasuredNoiseConfig(ConfigRecord):
    """Noise of accelerometer and gyro with the spectrum of real flights (sim_vehicle/sensors/vibration.py).

    Axes: x, y, z, body FRD. White noise is per sample at the IMU's rate. The others are standard deviations in hover
    of the signal that the sensor samples at 1 kHz; the IMU sends means of five such samples. They grow with thrust.
    """

    accelerometer_white_m_s2: UnitVector3 = Field(description="m/s^2, white")
    accelerometer_tone_m_s2: UnitVector3 = Field(description="m/s^2, of all rotors, once per revolution")
    accelerometer_broad_m_s2: UnitVector3 = Field(description="m/s^2, broad band, white before its high-pass")
    gyroscope_white_rad_s: UnitVector3 = Field(description="rad/s, white")
    gyroscope_tone_rad_s: UnitVector3 = Field(description="rad/s, of all rotors, once per revolution")
    gyroscope_broad_rad_s: UnitVector3 = Field(description="rad/s, broad band, white before its high-pass")
    blade_share: float = Field(ge=0.0, description="tone twice per revolution (two blades), share of the other")
    rotor_spread: float = Field(ge=0.0, lt=1.0, description="share by which the tones of the rotors differ, uniform")
    rotor_speed: tuple[RotorSpeed, RotorSpeed, RotorSpeed, RotorSpeed] = Field(
        description="factor of the speed that each rotor needs for its thrust, PX4 order; the tones of equal rotors "
        "would add up, or cancel, for a whole flight"
    )
    broad_above_hz: float = Field(gt=0.0, le=400.0, description="Hz, corner of the broad band's high-pass")
    factor: float = Field(ge=0.0, description="of all noise above")


class ImuConfig(ConfigRecord):
    """Accelerometer, gyro and barometer, which share HIL_SENSOR.

    Noise sigmas are per sample at the IMU's rate. Biases are drawn once per flight from the seed: accelerometer normal
    with the given sigmas, gyro uniform within plus or minus the given bounds.
    """

    noise: Literal["white", "measured"] = Field(
        default="white",
        description="of accelerometer and gyro; white: accelerometer_noise_m_s2, accelerometer_vibration_m_s2 and "
        "gyroscope_noise_rad_s; measured: the section measured",
    )
    measured: MeasuredNoiseConfig | None = Field(default=None, description="needed with noise: measured")
    accelerometer_bias_sigma_m_s2: UnitVector3 = Field(description="m/s^2")
    accelerometer_noise_m_s2: float = Field(ge=0.0, description="m/s^2, motors off")
    accelerometer_vibration_m_s2: float = Field(ge=0.0, description="m/s^2, at hover thrust, added in square")
    accelerometer_step_m_s2: float = Field(gt=0.0, description="m/s^2, quantisation")
    accelerometer_range_m_s2: float = Field(gt=0.0, description="m/s^2, full scale")
    gyroscope_bias_bound_rad_s: UnitVector3 = Field(description="rad/s")
    gyroscope_noise_rad_s: float = Field(ge=0.0, description="rad/s")
    gyroscope_step_rad_s: float = Field(gt=0.0, description="rad/s, quantisation")
    gyroscope_range_rad_s: float = Field(gt=0.0, description="rad/s, full scale")
    gyroscope_delay_samples: int = Field(ge=0, le=10, description="samples by which the gyro lags")
    pressure_noise_pa: float = Field(ge=0.0, description="Pa")
    pressure_bias_sigma_pa: float = Field(ge=0.0, description="Pa, drawn once")
    pressure_step_pa: float = Field(gt=0.0, description="Pa, quantisation")
    pressure_at_floor_pa: float = Field(gt=0.0, description="Pa at d = 0")

    @property
    def vibration(self) -> MeasuredNoiseConfig | None:
        """The noise as measured, if that is chosen."""
        return self.measured if self.noise == "measured" else None

    @model_validator(mode="after")
    def _measured_is_there(self) -> Self:
        if self.noise == "measured" and self.measured is None:
            raise ValueError("noise: measured needs the section measured")
        return self


class UltrasonicConfig(ConfigRecord):
    """Height by ultrasound."""

    rate_hz: float = Field(gt=0.0, le=200.0, description="Hz")
    noise_m: float = Field(ge=0.0, description="m")
    least_m: float = Field(gt=0.0, description="m, shorter distances read as this")
    greatest_m: float = Field(gt=0.0, description="m, beyond it there is no reading")
    outlier_probability: float = Field(ge=0.0, le=1.0, description="share of readings that are uniform in range")
    half_cone_rad: float = Field(ge=0.0, description="rad, tilt up to which the nearest floor is straight below")


class FlowConfig(ConfigRecord):
    """Optical flow camera."""

    rate_hz: float = Field(gt=0.0, le=200.0, description="Hz")
    noise_rad_s: float = Field(ge=0.0, description="rad/s per frame, at full quality")
    gyroscope_noise_rad_s: float = Field(ge=0.0, description="rad/s per frame")
    quality: int = Field(ge=0, le=255, description="quality over a good floor")
    least_m: float = Field(gt=0.0, description="m, out of focus below: quality 0")
    greatest_m: float = Field(gt=0.0, description="m, quality 0 above")
    rate_limit_rad_s: float = Field(gt=0.0, description="rad/s of flow beyond which quality is 0")


class OutageConfig(ConfigRecord):
    """A time without motion capture."""

    start_s: float = Field(ge=0.0, description="s, flight time")
    end_s: float = Field(gt=0.0, description="s, flight time")


class MotionCaptureConfig(ConfigRecord):
    """Motion capture of the room, which sends to the offboard host."""

    rate_hz: float = Field(gt=0.0, le=200.0, description="Hz")
    latency_s: float = Field(ge=0.0, le=1.0, description="s from capture to sending")
    position_noise_m: float = Field(ge=0.0, description="m, per axis")
    attitude_noise_rad: float = Field(ge=0.0, description="rad, per axis")
    loss_probability: float = Field(ge=0.0, le=1.0, description="share of frames that are not solved")
    outages: tuple[OutageConfig, ...] = Field(default=(), description="no frames at all in these times")


class SensorsConfig(ConfigRecord):
    """All sensors."""

    imu: ImuConfig
    ultrasonic: UltrasonicConfig
    flow: FlowConfig
    motion_capture: MotionCaptureConfig
    battery_noise_v: float = Field(ge=0.0, description="V")


class LinkConfig(ConfigRecord):
    """MAVLink identity of the vehicle's sensors and motors."""

    system_id: int = Field(ge=1, le=255)
    component_id: int = Field(ge=1, le=255)
    clock_offset_s: float = Field(ge=0.0, description="s on the vehicle's clock when the simulation starts")


class InitialConfig(ConfigRecord):
    """State at flight time 0."""

    position_ned_m: Vector3 | None = Field(default=None, description="m; left out: at rest on the floor at n = e = 0")
    velocity_ned_m_s: Vector3 = Field(default=(0.0, 0.0, 0.0), description="m/s")
    yaw_rad: float = Field(default=0.0, description="rad")
    hovering: bool = Field(default=False, description="whether the motors start at hover thrust")
