"""Everything that can befall the vehicle, as records that a scenario lists. Times are flight time: 0 is the start.

Each acts from `onset_s` until `end_s` (left out: for good). Several of one kind add up, or multiply where they are
factors. What is random in them is drawn from the flight's seed.
"""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from configs.loader import ConfigRecord
from protocol.geometry import Vector3


class _Timed(ConfigRecord):
    onset_s: float = Field(default=0.0, ge=0.0, description="s, flight time")
    end_s: float | None = Field(default=None, gt=0.0, description="s, flight time; left out: for good")

    @model_validator(mode="after")
    def _ends_after_onset(self) -> "_Timed":
        if self.end_s is not None and self.end_s <= self.onset_s:
            raise ValueError(f"end_s {self.end_s} is not after onset_s {self.onset_s}")
        return self


class RotorChip(_Timed):
    """A rotor loses part of its blades: less thrust and torque, and an imbalance that shakes the IMU."""

    kind: Literal["rotor_chip"] = "rotor_chip"
    rotor: Literal[1, 2, 3, 4, "random"] = Field(default="random", description="PX4 motor number")
    thrust_factor: float = Field(gt=0.0, le=1.0, description="thrust left")
    torque_factor: float | None = Field(
        default=None, gt=0.0, le=1.0, description="drag torque left; left out: thrust_factor^1.1, slightly lower"
    )
    mount_transmission: float = Field(
        default=0.15, ge=0.0, le=1.0, description="share of the raw shaking that reaches the accelerometer (0.05-0.3)"
    )
    gyroscope_rad_s_per_m_s2: float = Field(
        default=0.0026, ge=0.0, description="(rad/s)/(m/s^2) from raw shaking to the gyro (0.15 rad/s at 58 m/s^2)"
    )


class Wind(_Timed):
    """The same air velocity everywhere."""

    kind: Literal["wind"] = "wind"
    velocity_ned_m_s: Vector3 = Field(description="m/s, NED, where the air goes")


class FanJet(_Timed):
    """A round turbulent jet from a fan: wind that depends on the place."""

    kind: Literal["fan_jet"] = "fan_jet"
    origin_ned_m: Vector3 = Field(description="m, centre of the nozzle")
    direction_ned: Vector3 = Field(description="any length but zero")
    diameter_m: float = Field(gt=0.0, description="m, nozzle")
    speed_m_s: float = Field(ge=0.0, description="m/s at the nozzle")

    @model_validator(mode="after")
    def _has_direction(self) -> "FanJet":
        if sum(x * x for x in self.direction_ned) < 1e-12:
            raise ValueError("direction_ned has no length")
        return self


class Gusts(_Timed):
    """Turbulence of first order on each axis, frozen and carried past the vehicle by its speed through the mean air."""

    kind: Literal["gusts"] = "gusts"
    sigma_m_s: float = Field(ge=0.0, description="m/s per axis; indoors 0.1-0.2 of the mean wind")
    length_scale_m: float = Field(gt=0.0, description="m; indoors 0.3-1")
    advection_m_s: float | None = Field(
        default=None, gt=0.0, description="m/s; left out: the vehicle's speed through the mean air, at least 0.2"
    )


class Cloth(_Timed):
    """A cloth hanging below the frame: a pendulum, and flapping drag. Defaults: 10 x 10 cm of light fabric."""

    kind: Literal["cloth"] = "cloth"
    mass_kg: float = Field(default=0.0013, gt=0.0, le=0.02, description="kg (130 g/m^2)")
    length_m: float = Field(default=0.075, ge=0.02, le=0.5, description="m, of the pendulum (0.05-0.1)")
    damping_ratio: float = Field(default=0.15, ge=0.0, le=2.0)
    drag_at_3_m_s_n: float = Field(default=0.034, ge=0.0, description="N, mean drag at 3 m/s; grows with V^2")
    modulation: float = Field(default=0.8, ge=0.0, le=1.0, description="amplitude of the flapping, of the mean drag")
    across: float = Field(default=0.5, ge=0.0, le=1.0, description="amplitude across the wind, of that along it")
    flapping_hz_per_m_s: float = Field(default=2.0, ge=0.0, description="Hz/(m/s), kept within 4-12 Hz")
    fastening_m: float = Field(default=0.022, ge=0.0, description="m below the centre of mass")


class Payload(_Timed):
    """A point mass fixed to the frame. It has the vehicle's velocity when it comes and when it goes."""

    kind: Literal["payload"] = "payload"
    mass_kg: float = Field(gt=0.0, le=0.1, description="kg")
    offset_m: Vector3 = Field(default=(0.0, 0.0, 0.02), description="m, body FRD, from the centre")


class MotorGain(_Timed):
    """Thrust per command differs from the map: a common factor, and a spread between motors drawn from the seed."""

    kind: Literal["motor_gain"] = "motor_gain"
    common: float = Field(default=0.75, gt=0.0, le=1.5, description="really 0.65-0.85")
    spread: float = Field(default=0.1, ge=0.0, lt=1.0, description="half-width of the uniform spread between motors")


class BatterySag(_Timed):
    """The voltage falls further than the sound battery's, exponentially towards a drop."""

    kind: Literal["battery_sag"] = "battery_sag"
    drop_v: float = Field(default=0.3, ge=0.0, le=2.0, description="V, in the end")
    time_constant_s: float = Field(default=10.0, gt=0.0, description="s")


class SensorFault(_Timed):
    """A sensor falls silent, repeats its last reading with fresh time stamps, or sends NaN."""

    kind: Literal["sensor_fault"] = "sensor_fault"
    sensor: Literal["imu", "flow", "ultrasonic", "battery", "motion_capture"]
    fault: Literal["silent", "frozen", "not_finite"]

    @model_validator(mode="after")
    def _can_be_sent(self) -> "SensorFault":
        if self.fault == "not_finite" and self.sensor in ("ultrasonic", "battery"):
            raise ValueError(f"{self.sensor} sends whole numbers, which are always finite")
        return self


class ClockJump(_Timed):
    """The vehicle's clock (not motion capture's) is off by a jump; minus the onset: it counts from 0, as restarted."""

    kind: Literal["clock_jump"] = "clock_jump"
    jump_s: float = Field(ge=-3600.0, le=3600.0, description="s; the clock never shows less than 0")


Disturbance = Annotated[
    RotorChip | Wind | FanJet | Gusts | Cloth | Payload | MotorGain | BatterySag | SensorFault | ClockJump,
    Field(discriminator="kind"),
]
"""Any one of them; `kind` says which."""
