"""Scenarios: which vehicle, controller, path, disturbances and radio make up a flight; resolved into one full record.

A scenario file names the parts (configs/vehicle, configs/controllers, configs/radio) and lays its own values over
their defaults. The resolved record holds every value of the flight; it goes into the flight folder and each process
reads its own section of it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import yaml
from pydantic import Field, ValidationError

from configs.loader import CONFIG_DIRECTORY, ConfigError, Record, fill, merge, read_tree, set_path
from configs.network import NetworkConfig
from offboard.config import OffboardConfig
from onboard.config import OnboardConfig
from onboard.controllers.interface import Learner
from sim_vehicle.config import SimVehicleConfig, read_vehicle_tree
from sim_vehicle.radio import RadioConfig

DEFAULT_SCENARIO = "figure8_wind"


Seed = Annotated[int, Field(ge=0, lt=2**31)]
Duration = Annotated[float, Field(ge=5, le=3600, description="whole flight, boot to touch-down")]


class _Options(Record):
    """What `--seed` and `--duration` may be."""

    seed: Seed | None
    duration: Duration | None


class ScenarioFile(Record):
    """A scenario as written: the parts by name, and what is laid over them."""

    description: str
    duration_s: Duration
    seed: Seed = 1
    vehicle: str = "mambo"
    controller: str = "dmrac"
    radio: str = "good"
    guidance: dict[str, Any]
    disturbances: tuple[dict[str, Any], ...] = ()
    training_time_s: Annotated[float, Field(ge=0, le=10)] = 0.6
    experience: str = ""
    onboard: dict[str, Any] = Field(default_factory=dict)
    offboard: dict[str, Any] = Field(default_factory=dict)
    vehicle_values: dict[str, Any] = Field(default_factory=dict)
    radio_values: dict[str, Any] = Field(default_factory=dict)


class FlightConfig(Record):
    """Everything about one flight, resolved."""

    scenario: str
    description: str
    controller: str
    seed: Seed
    duration_s: Duration
    training_time_s: Annotated[float, Field(ge=0, le=10, description="lockstep: modelled time of a training round")]
    experience: Annotated[str, Field(description="lockstep: file of what an earlier flight learnt; empty: nothing")] = (
        ""
    )
    onboard: OnboardConfig
    offboard: OffboardConfig
    vehicle: SimVehicleConfig
    radio: RadioConfig
    network: NetworkConfig

    def to_yaml(self) -> str:
        """The record as YAML that the processes read back."""
        tree = self.model_dump(mode="json", by_alias=True)
        return yaml.safe_dump(tree, sort_keys=False, allow_unicode=True, width=110)


@dataclass(frozen=True)
class Choices:
    """What the command line may lay over a scenario."""

    controller: str | None = None
    seed: int | None = None
    duration_s: float | None = None
    assignments: Sequence[str] = ()
    """`path.to.key=value`, on the resolved tree."""
    real: bool = False
    """For a real vehicle: nothing happens by itself, and every limit is tight (configs/real_vehicle.yaml)."""


def named_file(kind: str, name: str) -> Path:
    """The file of a part: configs/<kind>/<name>.yaml, or a path that ends in .yaml.

    Raises
    ------
    ConfigError
        If there is none; the message lists the names there are.
    """
    directory = CONFIG_DIRECTORY / kind
    path = Path(name) if name.endswith((".yaml", ".yml")) else directory / f"{name}.yaml"
    if not path.is_file():
        known = ", ".join(sorted(file.stem for file in directory.glob("*.yaml")))
        singular = kind.removesuffix("s")
        raise ConfigError(f"unknown {singular} {name!r}: allowed are {known}, or the path of a .yaml file")
    return path


def resolve(scenario: str = DEFAULT_SCENARIO, choices: Choices | None = None) -> FlightConfig:
    """The full record of a flight.

    Raises
    ------
    ConfigError
        Naming file, path, value and what is allowed.
    """
    choices = choices or Choices()
    _check_choices(choices)
    path = named_file("scenarios", scenario)
    file = fill(ScenarioFile, read_tree(path), str(path))
    tree = compose(file, path.stem, choices)
    for assignment in choices.assignments:
        tree = set_path(tree, assignment)
    source = str(path) + ("".join(f" --set {item}" for item in choices.assignments))
    return complete(tree, source)


def _check_choices(choices: Choices) -> None:
    """An option out of range is named as what was typed, not as the keys of the file that it would have changed."""
    try:
        _Options(seed=choices.seed, duration=choices.duration_s)
    except ValidationError as error:
        fault = error.errors()[0]
        raise ConfigError(f"--{fault['loc'][0]} {fault['input']}: {fault['msg']}") from None


def complete(tree: Mapping[str, Any], source: str) -> FlightConfig:
    """The record of a flight's plain tree; an offboard side that nobody would learn from only relays the pose.

    Raises
    ------
    ConfigError
        Naming `source`, path, value and what is allowed.
    """
    flight = fill(FlightConfig, tree, source)
    _, and_set, assignments = source.partition(" --set ")
    law = f"{named_file('controllers', flight.controller)}{and_set}{assignments}"
    controller = flight.onboard.controller.build(flight.onboard.airframe, flight.seed, law)
    learns = isinstance(controller, Learner) and controller.accepts_features
    return flight if learns else _without_training(flight)


def _without_training(flight: FlightConfig) -> FlightConfig:
    """The same flight with an offboard side that relays the pose and learns nothing: no one would use it."""
    experience = flight.offboard.experience.model_copy(update={"mode": "frozen"})
    return flight.model_copy(update={"offboard": flight.offboard.model_copy(update={"experience": experience})})


def compose(file: ScenarioFile, name: str, choices: Choices) -> dict[str, Any]:
    """The plain tree of a flight: defaults of the parts, then the scenario's values, then the choices."""
    seed = file.seed if choices.seed is None else choices.seed
    duration = file.duration_s if choices.duration_s is None else choices.duration_s
    controller = choices.controller or file.controller
    onboard = merge(read_tree(CONFIG_DIRECTORY / "onboard.yaml"), {"guidance": _guidance(file, duration)})
    onboard = merge(onboard, _simulated_pilot(onboard))
    careful = read_tree(CONFIG_DIRECTORY / "real_vehicle.yaml") if choices.real else {}
    law = read_tree(named_file("controllers", controller))
    onboard = merge(onboard, {"guidance": law.pop("guidance", {})})  # leads that were tuned with the controller
    onboard = merge(onboard, {"seed": seed, "controller": law})
    vehicle = merge(read_vehicle_tree(named_file("vehicle", file.vehicle)), {"disturbances": list(file.disturbances)})
    return {
        "scenario": name,
        "description": file.description,
        "controller": controller,
        "seed": seed,
        "duration_s": duration,
        "training_time_s": file.training_time_s,
        "experience": file.experience,
        "onboard": merge(merge(onboard, file.onboard), careful),
        "offboard": merge(merge(read_tree(CONFIG_DIRECTORY / "offboard.yaml"), {"seed": seed}), file.offboard),
        "vehicle": merge(vehicle, file.vehicle_values),
        "radio": merge(read_tree(named_file("radio", file.radio)), file.radio_values),
        "network": read_tree(CONFIG_DIRECTORY / "network.yaml"),
    }


def _simulated_pilot(onboard: Mapping[str, Any]) -> dict[str, Any]:
    """In simulation the vehicle arms and takes off by itself, and flies on by optical flow when the pose is lost.

    Its sensors may come as irregularly as a shared machine runs it.
    """
    altitude = onboard["guidance"]["trajectory"].get("altitude_m", 1.0)
    return {
        "supervisor": {
            "auto_arm": True,
            "arm_needs_pose": False,
            "on_pose_stale": "continue",
            "take_off_height_m": altitude,
        },
        "vehicle_link": {
            "health": {
                "imu_rate_min_hz": 50.0,
                "late_s": 0.1,
                "late_share_max": 0.5,
                "gap_max_s": 0.5,
                "clock_rate_tolerance": 0.5,
            }
        },
    }


def _guidance(file: ScenarioFile, duration_s: float) -> dict[str, Any]:
    """Guidance with the landing placed so that the vehicle is down when the flight's time is over."""
    defaults = read_tree(CONFIG_DIRECTORY / "guidance.yaml")
    guidance = merge(defaults, file.guidance)
    trajectory = guidance["trajectory"]
    try:
        landing_s = float(trajectory["altitude_m"]) / float(trajectory["landing_speed_m_s"]) + 3.0
    except (KeyError, TypeError, ValueError, ZeroDivisionError):
        landing_s = 4.0  # the record's own check names the fault
    return merge(guidance, {"land_after_s": max(duration_s - landing_s, 1.0)})
