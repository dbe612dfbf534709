"""Composes a flight's whole configuration: the plain trees of the YAML files, laid over one another.

A scenario file names the parts (configs/vehicles, configs/controllers, configs/radio) and lays its own values over
theirs. Only the scenario file is checked here. Each process checks its own section when it fills its records with it
(experiments.flights.scenario checks all sections), so no process needs the code of another.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Final

from pydantic import Field, ValidationError

from configs.addresses import Addresses
from configs.loader import CONFIG_DIRECTORY, ConfigError, ConfigRecord, fill, merge, read_tree, set_path
from configs.parts import named_file, read_part
from configs.user_class import with_absolute_file
from configs.vehicle import read_vehicle, value_at

DEFAULT_SCENARIO: Final = "figure8_wind"
FEATURES_FILE: Final = CONFIG_DIRECTORY / "features.yaml"
GUIDANCE_FILE: Final = CONFIG_DIRECTORY / "guidance.yaml"
Seed = Annotated[int, Field(ge=0, lt=2**31)]
Duration = Annotated[float, Field(ge=5, le=3600, description="whole flight, boot to touch-down")]
VehicleNumber = Annotated[int, Field(ge=1, le=100)]
PORTS_EACH: Final = 100
"""Vehicle n has the default ports plus n - 1 times this."""
FORMER_PATHS: Final = {
    "offboard.network.features": "features.trained.count",
    "offboard.network": "features.trained",
}
"""Paths that had another name when the flights of docs/data were flown. Assignments to them still work."""
REAL_PEERS: Final = ("vehicle", "ground")
"""Addresses that a real vehicle and its ground station bind themselves."""


class _Options(ConfigRecord):
    """The allowed values of `--seed`, `--duration` and `--vehicle`."""

    seed: Seed | None
    duration: Duration | None
    vehicle: VehicleNumber


class ScenarioFile(ConfigRecord):
    """A scenario file: the parts by name, and the values that are laid over them."""

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


@dataclass(frozen=True)
class Choices:
    """What the command line or a Python program may change of a scenario."""

    controller: str | None = None
    seed: int | None = None
    duration_s: float | None = None
    assignments: Sequence[str] = ()
    """`path.to.key=value`, on the resolved tree."""
    real: bool = False
    """For a real vehicle: configs/real_vehicle.yaml instead of configs/simulated_vehicle.yaml."""
    vehicle: int = 1
    """Its number where several fly at once: its id on the link, and which ports it has."""
    vehicle_file: str | None = None
    """Name in configs/vehicles, or a file: another vehicle than the scenario's."""
    law: Mapping[str, Any] | None = None
    """What a controller file holds, for a controller that has none; `controller` is its name then."""
    disturbances: Sequence[Mapping[str, Any]] = ()
    """After those of the scenario."""
    radio: str | None = None
    """Name in configs/radio, or a file: another radio than the scenario's."""


def flight_tree(scenario: str = DEFAULT_SCENARIO, choices: Choices | None = None) -> tuple[dict[str, Any], str]:
    """The plain tree of a flight, and the file and options that it was made of, for messages.

    Raises
    ------
    ConfigError
        Naming file or option, path, value and what is allowed.
    """
    choices = choices or Choices()
    _check_choices(choices)
    path = named_file("scenarios", scenario)
    file = read_scenario(scenario)
    if choices.vehicle_file is not None:
        file = file.model_copy(update={"vehicle": choices.vehicle_file})
    if choices.radio is not None:
        file = file.model_copy(update={"radio": choices.radio})
    tree = compose(file, path.stem, choices)
    if choices.vehicle != 1:
        tree = numbered(tree, choices.vehicle, choices.real)
    for assignment in choices.assignments:
        tree = set_path(tree, _present_path(assignment))
    own = [f", {kind} {name}" for kind, name in (("vehicle", file.vehicle), ("radio", file.radio)) if "." in name]
    return tree, "".join([str(path), *own, *(f" --set {item}" for item in choices.assignments)])


def read_scenario(name: str) -> ScenarioFile:
    """A scenario by its name in configs/scenarios, or by its file. Raises ConfigError."""
    path = named_file("scenarios", name)
    file = fill(ScenarioFile, read_part("scenarios", name), str(path))
    disturbances = tuple(with_absolute_file(one, "kind", path.parent) for one in file.disturbances)
    return file.model_copy(update={"disturbances": disturbances})


def read_law(controller: str) -> dict[str, Any]:
    """The content of a controller file, by its name in configs/controllers or its path. Raises ConfigError."""
    folder = named_file("controllers", controller).parent
    return with_absolute_file(read_part("controllers", controller), "class", folder)


def _present_path(assignment: str) -> str:
    """The assignment, with the present path of its value."""
    for former, present in FORMER_PATHS.items():
        if re.match(rf"\s*{re.escape(former)}[.=\s]", assignment):
            return assignment.replace(former, present, 1)
    return assignment


def _check_choices(choices: Choices) -> None:
    """Raises ConfigError that names the option as it was typed, not the keys that it would have changed."""
    try:
        _Options(seed=choices.seed, duration=choices.duration_s, vehicle=choices.vehicle)
    except ValidationError as error:
        fault = error.errors()[0]
        raise ConfigError(f"--{fault['loc'][0]} {fault['input']}: {fault['msg']}") from None


def numbered(tree: Mapping[str, Any], vehicle: int, real: bool = False) -> dict[str, Any]:
    """A flight's plain tree for one of several vehicles: with its id, and with ports that no other vehicle has.

    real: the ports of the vehicle and of the ground station stay, because these bind them.
    """
    by = PORTS_EACH * (vehicle - 1)
    stay = REAL_PEERS if real else ()
    network = {name: _port_above(value, by) for name, value in tree["network"].items() if name not in stay}
    own = {"vehicle_id": vehicle}
    return merge(tree, {"onboard": own, "offboard": own, "network": network})


def _port_above(value: Any, by: int) -> Any:
    """An address with a higher port. A value without a port (serial line, key file, None) is returned unchanged."""
    host, _, port = str(value).rpartition(":")
    return f"{host}:{int(port) + by}" if port.isdecimal() else value


def compose(file: ScenarioFile, name: str, choices: Choices) -> dict[str, Any]:
    """The plain tree of a flight: the parts, then the scenario's values, then the choices."""
    seed = file.seed if choices.seed is None else choices.seed
    duration = file.duration_s if choices.duration_s is None else choices.duration_s
    controller = choices.controller or file.controller
    vehicle = read_vehicle(file.vehicle)
    law = read_law(controller) if choices.law is None else dict(choices.law)
    features = merge(read_tree(FEATURES_FILE), law.pop("features", {}))
    guidance = merge(_guidance(file, duration, seed), law.pop("guidance", {}))  # leads tuned with the controller
    onboard = {"seed": seed, "airframe": vehicle.airframe, "controller": law, "guidance": guidance}
    return {
        "scenario": name,
        "description": file.description,
        "controller": controller,
        "seed": seed,
        "duration_s": duration,
        "training_time_s": file.training_time_s,
        "experience": file.experience,
        "features": features,
        "onboard": _onboard(onboard, file, choices.real),
        "offboard": merge({"seed": seed}, file.offboard),
        "vehicle": merge(
            merge(vehicle.simulated, {"disturbances": [*file.disturbances, *choices.disturbances]}), file.vehicle_values
        ),
        "radio": merge(read_part("radio", file.radio), file.radio_values),
        "network": Addresses().model_dump(mode="json", exclude_none=True),
    }


def _onboard(onboard: Mapping[str, Any], file: ScenarioFile, real: bool) -> dict[str, Any]:
    """Onboard's section for a simulated or a real vehicle. A scenario cannot overrule the limits for a real one."""
    altitude_m = value_at(onboard, "guidance.trajectory.altitude_m") or 1.0
    onboard = merge(onboard, {"supervisor": {"take_off_height_m": altitude_m}})
    if real:
        return merge(merge(onboard, file.onboard), read_tree(CONFIG_DIRECTORY / "real_vehicle.yaml"))
    return merge(merge(onboard, read_tree(CONFIG_DIRECTORY / "simulated_vehicle.yaml")), file.onboard)


def _guidance(file: ScenarioFile, duration_s: float, seed: int) -> dict[str, Any]:
    """Guidance whose landing begins early enough for the vehicle to be down when the flight's time is over.

    A lissajous path without a seed of its own gets the flight's.
    """
    guidance = merge(read_tree(GUIDANCE_FILE), file.guidance)
    if value_at(guidance, "trajectory.path.kind") == "lissajous":
        guidance = merge({"trajectory": {"path": {"seed": seed}}}, guidance)
    height, speed = (value_at(guidance, f"trajectory.{key}") for key in ("altitude_m", "landing_speed_m_s"))
    try:
        landing_s = float(height) / float(speed) + 3.0
    except (TypeError, ValueError, ZeroDivisionError):
        landing_s = 4.0  # the check of the record names the fault
    return merge(guidance, {"land_after_s": max(duration_s - landing_s, 1.0)})
