"""Configuration of the simulated vehicle, read from configs/vehicles/*.yaml."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, Self, TypeAlias

from pydantic import Field, model_validator

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
    RotorpyConfig,
    SensorsConfig,
)
from sim_vehicle.world.catalogue import AnyDisturbance
from sim_vehicle.world.rotorpy_wind import RotorpyWind

PhysicsName: TypeAlias = Literal["own", "mujoco", "rotorpy"]


class SimVehicleConfig(ConfigRecord):
    """One simulated vehicle and its disturbances."""

    physics: PhysicsName = Field(
        default="own",
        description="what integrates the rigid body; mujoco: MuJoCo, with its own contact with the floor (extra "
        "`mujoco`); rotorpy: RotorPy, with its own motors and air forces (extra `rotorpy`)",
    )
    rotorpy: RotorpyConfig | None = Field(
        default=None, description="of physics rotorpy only; left out: the defaults of its keys"
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

    @model_validator(mode="after")
    def _uses_all(self) -> Self:
        if self.physics != "rotorpy":
            for k, one in enumerate(self.disturbances):
                if isinstance(one, RotorpyWind):
                    raise ValueError(f"disturbances.{k}: {one.kind} needs physics 'rotorpy', not {self.physics!r}")
            if self.rotorpy is not None:
                raise ValueError(f"rotorpy: its keys need physics 'rotorpy', not {self.physics!r}")
        return self


def load_vehicle(name: str | Path = "mambo", over: Mapping[str, Any] | None = None) -> SimVehicleConfig:
    """A vehicle's configuration with `over` (a plain tree) laid over it. Raises ConfigError."""
    return fill(SimVehicleConfig, merge(read_vehicle(str(name)).simulated, over or {}), str(name))
