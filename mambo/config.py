"""Settings of the drone's library: where the firmware's numbers stand, signs, motors, link and watchdogs.

They are the part of the configuration image that the laptop's onboard process does not have. configs/mambo.yaml has
their values; image.py packs them.
"""

from typing import Annotated, Final, Literal, Self

from pydantic import Field, model_validator

from configs.addresses import RESERVED_PORTS
from configs.loader import ConfigRecord
from onboard.config import OnboardConfig

ACQUISITION_BYTES: Final = 2432
"""Size of the firmware's acquisition structure."""
FIRMWARE_PORTS: Final = (12391, 17725, *RESERVED_PORTS)
"""UDP ports of the firmware."""

Offset = Annotated[int, Field(ge=0, le=ACQUISITION_BYTES - 60, multiple_of=4)]
Axis = Annotated[int, Field(ge=-3, le=3)]
Octet = Annotated[int, Field(ge=0, le=255)]
Motor = Annotated[int, Field(ge=1, le=4)]
Axes = tuple[Axis, Axis, Axis]
Ipv4 = tuple[Octet, Octet, Octet, Octet]


def _permutation(axes: tuple[int, ...]) -> bool:
    return sorted(map(abs, axes)) == list(range(1, len(axes) + 1))


class BoardLayout(ConfigRecord):
    """Places in the acquisition structure, bytes from its start."""

    accelerometer: Offset = Field(default=20, description="3 floats")
    gyroscope: Offset = Field(default=36, description="3 floats")
    fifo_gyroscope: Offset = Field(default=192, description="5 x 3 floats of 1 kHz, the newest last")
    fifo_accelerometer: Offset = Field(default=252, description="5 x 3 floats of 1 kHz, the newest last")
    pressure: Offset = Field(default=360, description="float")
    altitude: Offset = Field(default=384, description="float, ultrasonic")
    battery_voltage: Offset = Field(default=1584, description="float")
    battery_percent: Offset = Field(default=1588, description="32-bit unsigned")


class BoardSensors(ConfigRecord):
    """Axes, signs and units. An axis is the firmware's axis, 1 to 3, that body x, y, z is; negative: turned over."""

    imu: Literal["fifo", "single"] = Field(default="fifo", description="five samples a call, averaged, or one")
    accelerometer_axes: Axes = Field(default=(1, 2, 3), description="of body x, y, z")
    gyroscope_axes: Axes = Field(default=(1, 2, 3), description="of body x, y, z")
    flow_axes: tuple[Axis, Axis] = Field(default=(1, 2), description="of body x, y")
    accelerometer_scale: float = Field(default=1.0, gt=0, le=100, description="m/s^2 a unit")
    gyroscope_scale: float = Field(default=1.0, gt=0, le=100, description="rad/s a unit")
    pressure_scale: float = Field(default=1.0, gt=0, le=1e4, description="Pa a unit")
    altitude_scale: float = Field(default=1.0, gt=0, le=100, description="m a unit")
    flow_scale: float = Field(default=1.0, gt=0, le=100, description="m/s a unit")
    flow_compensated: bool = Field(default=True, description="the camera's rotation is taken out of the flow already")
    flow_quality: Literal["defined", "share", "byte"] = Field(
        default="defined", description="defined: the flag alone counts; share: 0 to 1; byte: 0 to 255"
    )

    @model_validator(mode="after")
    def _each_axis_once(self) -> Self:
        for name in ("accelerometer_axes", "gyroscope_axes", "flow_axes"):
            axes = getattr(self, name)
            if not _permutation(axes):
                raise ValueError(f"{name} {axes}: allowed is each of 1 to {len(axes)} once, with a sign")
        return self


class BoardMotors(ConfigRecord):
    """From shares of the maximum thrust to the firmware's commands."""

    order: tuple[Motor, Motor, Motor, Motor] = Field(
        default=(3, 1, 4, 2), description="PX4 number of the firmware's motors 1 to 4"
    )
    command_max: int = Field(default=500, ge=1, le=32767, description="command of the maximum thrust")
    command_min: int = Field(default=10, ge=0, le=1000, description="least command of a motor that turns")

    @model_validator(mode="after")
    def _each_motor_once(self) -> Self:
        if not _permutation(self.order):
            raise ValueError(f"order {self.order}: allowed is each of 1 to 4 once")
        return self


class BoardLink(ConfigRecord):
    """Addresses of the link to offboard and of the ground station; port 0: no ground station."""

    own_port: int = Field(default=14571, ge=1, le=65535, description="UDP, of the library")
    offboard: Ipv4 = Field(default=(192, 168, 3, 2), description="IPv4 of offboard's machine")
    offboard_port: int = Field(default=14573, ge=1, le=65535, description="UDP")
    ground: Ipv4 = Field(default=(192, 168, 3, 2), description="IPv4 of the ground station")
    ground_port: int = Field(default=14550, ge=0, le=65535, description="UDP; 0: none")
    ground_own_port: int = Field(default=14552, ge=1, le=65535, description="UDP, of the library")
    features_in_flight: bool = Field(
        default=True, description="receive feature versions in flight; false: on the ground only"
    )
    datagrams_max: int = Field(default=8, ge=1, le=64, description="read in a call, of each socket")

    @model_validator(mode="after")
    def _not_the_firmwares(self) -> Self:
        for name in ("own_port", "ground_own_port"):
            if getattr(self, name) in FIRMWARE_PORTS:
                raise ValueError(f"{name} {getattr(self, name)}: the firmware has {FIRMWARE_PORTS}; choose another")
        if self.own_port == self.ground_own_port:
            raise ValueError(f"ground_own_port {self.ground_own_port}: own_port has the same; choose another")
        return self


class BoardWatchdogs(ConfigRecord):
    """When the library stops trusting its surroundings (docs/real_mambo.md)."""

    twice_s: float = Field(default=0.001, ge=0, le=0.004, description="s; a call sooner is the same call again")
    late_land_s: float = Field(default=0.030, gt=0, le=1, description="s between two calls; land")
    late_stop_s: float = Field(default=0.100, gt=0, le=1, description="s between two calls; motors off")
    frozen_calls: int = Field(default=4, ge=2, le=100, description="identical acquisitions; they no longer count")
    budget_s: float = Field(default=0.0025, gt=0, le=0.005, description="s of a call; half of the period")
    budget_late_calls: int = Field(default=20, ge=1, le=200, description="calls over it, of the last 200: next stage")
    budget_stage_s: float = Field(default=0.5, ge=0.05, le=10, description="s of a stage before the next one")
    heed_stop: bool = Field(default=True, description="a STOP that the firmware wrote over our command ends the flight")
    rate_min_hz: float = Field(default=180.0, gt=0, le=1000, description="Hz of the calls; no arming below, land")
    rate_max_hz: float = Field(default=220.0, gt=0, le=1000, description="Hz of the calls; no arming above")


class BoardRecord(ConfigRecord):
    """The modes record and bench."""

    duration_s: float = Field(default=120.0, gt=0, le=900, description="s of acquisitions; then nothing is written")
    whole_every: int = Field(default=40, ge=1, le=2000, description="calls between two whole structures")
    bench_command: int = Field(default=60, ge=10, le=150, description="of the one motor that turns")
    bench_turn_s: float = Field(default=2.0, gt=0.1, le=5, description="s that each motor turns")
    bench_pause_s: float = Field(default=2.0, gt=0.1, le=10, description="s between two motors")


class BoardConfig(ConfigRecord):
    """Everything of the library alone."""

    mode: Literal["record", "bench", "fly"] = Field(default="record", description="record and bench never fly")
    layout: BoardLayout = BoardLayout()
    sensors: BoardSensors = BoardSensors()
    motors: BoardMotors = BoardMotors()
    link: BoardLink = BoardLink()
    watchdogs: BoardWatchdogs = BoardWatchdogs()
    record: BoardRecord = BoardRecord()


class ArmingLimits(ConfigRecord):
    """Limits of readings, and of what must be true before arming: onboard's own, for C."""

    cleared: bool = Field(description="dmrac mambo check has passed with these settings")
    acceleration_max_m_s2: float = Field(gt=0, description="m/s^2; more is a sensor fault")
    rate_max_rad_s: float = Field(gt=0, description="rad/s; more is a sensor fault")
    pressure_min_pa: float = Field(gt=0, description="Pa")
    pressure_max_pa: float = Field(gt=0, description="Pa")
    distance_max_m: float = Field(gt=0, description="m; more is a sensor fault")
    gap_max_s: float = Field(gt=0, description="s between two calls")
    gravity_tolerance_m_s2: float = Field(gt=0, description="m/s^2; |accelerometer| at rest against 1 g")
    rest_rate_max_rad_s: float = Field(gt=0, description="rad/s; mean rate at rest")
    flow_silent_s: float = Field(ge=0, description="s without optical flow; 0: it is not needed")
    needs_pose: bool = Field(description="a fresh pose is needed for arming")
    pose_wait_s: float = Field(ge=-1, le=600, description="s that arming waits for a first pose; -1: until it comes")
    pose_stale_s: float = Field(gt=0, description="s; an older pose is not judged")
    pose_rate_min_hz: float = Field(gt=0, description="Hz, poses that arrive")
    upright_tolerance_rad: float = Field(gt=0, description="rad; pose's upright against the IMU's")
    floor_tolerance_m: float = Field(gt=0, description="m; pose's height of a vehicle on the floor")


class LibraryConfig(ConfigRecord):
    """The library's part of the configuration image."""

    board: BoardConfig
    arming: ArmingLimits


def library_config(board: BoardConfig, onboard: OnboardConfig, cleared: bool) -> LibraryConfig:
    """The library's part, with the limits of onboard's configuration."""
    link, pose = onboard.vehicle_link, onboard.pose_health
    health = link.health
    arming = ArmingLimits(
        cleared=cleared,
        acceleration_max_m_s2=link.acceleration_max_m_s2,
        rate_max_rad_s=link.rate_max_rad_s,
        pressure_min_pa=link.pressure_min_pa,
        pressure_max_pa=link.pressure_max_pa,
        distance_max_m=link.distance_max_m,
        gap_max_s=health.gap_max_s,
        gravity_tolerance_m_s2=health.gravity_tolerance_m_s2,
        rest_rate_max_rad_s=health.rest_rate_max_rad_s,
        flow_silent_s=health.flow_silent_s,
        needs_pose=onboard.supervisor.arm_needs_pose,
        pose_wait_s=-1.0 if onboard.pose_wait_s is None else onboard.pose_wait_s,
        pose_stale_s=onboard.supervisor.pose_stale_s,
        pose_rate_min_hz=pose.rate_min_hz,
        upright_tolerance_rad=pose.upright_tolerance_rad,
        floor_tolerance_m=pose.floor_tolerance_m,
    )
    return LibraryConfig(board=board, arming=arming)
