"""Configuration of the simulated vehicle, read from configs/vehicles/*.yaml."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, TypeAlias

from pydantic import Field

from configs.loader import ConfigRecord, fill, merge
from configs.vehicle import read_vehicle
from sim_vehicle.link.radio import RadioConfig
from sim_vehicle.physics.parameters import (
    BatteryConfig,
    BodyConfig,
    DragConfig,
    FloorConfig,
    InitialConfig,
    LinkConfig,
    MotorConfig,
    NominalConfig,
    SensorsConfig,
)
from sim_vehicle.world.catalogue import AnyDisturbance

PhysicsName: TypeAlias = Literal["own", "mujoco"]


class SimVehicleConfig(ConfigRecord):
    """One simulated vehicle and its disturbances."""

    physics: PhysicsName = Field(
        default="own",
        description="what integrates the rigid body and its contact with the floor; mujoco: MuJoCo (extra `mujoco`)",
    )
    body: BodyConfig
    motors: MotorConfig
    battery: BatteryConfig
    drag: DragConfig
    floor: FloorConfig
    nominal: NominalConfig
    sensors: SensorsConfig
    link: LinkConfig
    initial: InitialConfig = InitialConfig()
    disturbances: tuple[AnyDisturbance, ...] = Field(default=(), max_length=64)
    impairment: RadioConfig | None = Field(
        default=None, description="of the vehicle's own link, up: sensors, down: motors; left out: none"
    )
    box_m: float = Field(
        default=10.0, gt=0.0, description="m; the vehicle is lost beyond this distance from the origin"
    )


def load_vehicle(name: str | Path = "mambo", over: Mapping[str, Any] | None = None) -> SimVehicleConfig:
    """A vehicle's configuration with `over` (a plain tree) laid over it. Raises ConfigError."""
    return fill(SimVehicleConfig, merge(read_vehicle(str(name)).simulated, over or {}), str(name))
