"""The simulated vehicle's configuration, and how configs/vehicle/*.yaml is read."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import Field

from configs.loader import CONFIG_DIRECTORY, ConfigError, Record, fill, merge, read_tree
from sim_vehicle.disturbances import Disturbance
from sim_vehicle.parameters import (
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
from sim_vehicle.radio import RadioConfig

VEHICLE_DIRECTORY = CONFIG_DIRECTORY / "vehicle"


class SimVehicleConfig(Record):
    """One simulated vehicle in its world."""

    body: BodyConfig
    motors: MotorConfig
    battery: BatteryConfig
    drag: DragConfig
    floor: FloorConfig
    nominal: NominalConfig
    sensors: SensorsConfig
    link: LinkConfig
    initial: InitialConfig = InitialConfig()
    disturbances: tuple[Disturbance, ...] = Field(default=(), max_length=64)
    impairment: RadioConfig | None = Field(
        default=None, description="of the vehicle's own link, up: sensors, down: motors; left out: a perfect wire"
    )
    box_m: float = Field(default=10.0, gt=0.0, description="m, further than this from the origin the flight is lost")


def read_vehicle_tree(name: str | Path) -> dict[str, Any]:
    """The plain tree of a vehicle: `name` is a file, or the name of one in configs/vehicle.

    A file whose `based_on` names another vehicle holds only what differs from it.

    Raises
    ------
    ConfigError
        If a file cannot be read, or vehicles are based on each other in a ring.
    """
    tree: dict[str, Any] = {}
    seen: list[Path] = []
    below: Any = name
    while below is not None:
        path = VEHICLE_DIRECTORY / f"{below}.yaml" if Path(below).suffix == "" else Path(below)
        if path in seen:
            raise ConfigError(f"{path}: based_on goes round in a ring")
        seen.append(path)
        layer = read_tree(path)
        below = layer.pop("based_on", None)
        tree = merge(layer, tree)
    return tree


def load_vehicle(name: str | Path = "mambo", over: Mapping[str, Any] | None = None) -> SimVehicleConfig:
    """A vehicle's configuration with `over` (a plain tree) laid over it. Raises ConfigError."""
    return fill(SimVehicleConfig, merge(read_vehicle_tree(name), over or {}), str(name))
