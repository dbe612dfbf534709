"""How a flight's whole configuration comes together: plain trees of the YAML files, laid over one another.

A scenario file names the parts (configs/vehicles, configs/controllers, configs/radio) and lays its own values over
their defaults. Nothing is checked here but the scenario file itself: each process fills its own records from its
section (experiments.flights.scenario from all of them), so that none needs the others' code.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Final

from pydantic import Field, ValidationError

from configs.loader import CONFIG_DIRECTORY, ConfigError, ConfigRecord, fill, merge, read_tree, set_path
from configs.parts import named_file, read_part
from configs.vehicle import read_vehicle

DEFAULT_SCENARIO: Final = "figure8_wind"


Seed = Annotated[int, Field(ge=0, lt=2**31)]
Duration = Annotated[float, Field(ge=5, le=3600, description="whole flight, boot to touch-down")]


VehicleNumber = Annotated[int, Field(ge=1, le=100)]
PORTS_EACH: Final = 100
"""The ports of vehicle n lie so many times n - 1 above those of network.yaml."""
FORMER_PATHS: Final = {
    "offboard.network.features": "features.trained.count",
    "offboard.network": "features.trained",
}
"""Where a value was when the flights of docs/data were flown, and where it is now: their assignments still work."""
REAL_PEERS: Final = ("vehicle", "ground")
"""Addresses that a real vehicle and its ground station bind themselves."""


class _Options(ConfigRecord):
    """What `--seed`, `--duration` and `--vehicle` may be."""

    seed: Seed | None
    duration: Duration | None
    vehicle: VehicleNumber


class ScenarioFile(ConfigRecord):
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
    vehicle: int = 1
    """Its number, where several fly at once: its id on the link, and ports of its own."""


def flight_tree(scenario: str = DEFAULT_SCENARIO, choices: Choices | None = None) -> tuple[dict[str, Any], str]:
    """The plain tree of a flight, and what it was made of, for messages.

    Raises
    ------
    ConfigError
        Naming file or option, path, value and what is allowed.
    """
    choices = choices or Choices()
    _check_choices(choices)
    path = named_file("scenarios", scenario)
    tree = compose(read_scenario(scenario), path.stem, choices)
    if choices.vehicle != 1:
        tree = numbered(tree, choices.vehicle, choices.real)
    for assignment in choices.assignments:
        tree = set_path(tree, _present_path(assignment))
    return tree, str(path) + "".join(f" --set {item}" for item in choices.assignments)


def read_scenario(name: str) -> ScenarioFile:
    """A scenario by its name in configs/scenarios, or by its file. Raises ConfigError."""
    return fill(ScenarioFile, read_part("scenarios", name), str(named_file("scenarios", name)))


def _present_path(assignment: str) -> str:
    """The same assignment with the path that the value has now."""
    for former, present in FORMER_PATHS.items():
        if re.match(rf"\s*{re.escape(former)}[.=\s]", assignment):
            return assignment.replace(former, present, 1)
    return assignment


def _check_choices(choices: Choices) -> None:
    """An option out of range is named as what was typed, not as the keys of the file that it would have changed."""
    try:
        _Options(seed=choices.seed, duration=choices.duration_s, vehicle=choices.vehicle)
    except ValidationError as error:
        fault = error.errors()[0]
        raise ConfigError(f"--{fault['loc'][0]} {fault['input']}: {fault['msg']}") from None


def numbered(tree: Mapping[str, Any], vehicle: int, real: bool = False) -> dict[str, Any]:
    """A flight's plain tree for one of several vehicles: with its id, and beside the others' ports.

    real: the ports of vehicle and ground station are theirs and stay.
    """
    by = PORTS_EACH * (vehicle - 1)
    stay = REAL_PEERS if real else ()
    network = {name: _port_above(value, by) for name, value in tree["network"].items() if name not in stay}
    own = {"vehicle_id": vehicle}
    return merge(tree, {"onboard": own, "offboard": own, "network": network})


def _port_above(value: Any, by: int) -> Any:
    """An address with a higher port; what has none (a serial line, a key file, nothing) stays as it is."""
    host, _, port = str(value).rpartition(":")
    return f"{host}:{int(port) + by}" if port.isdecimal() else value


def compose(file: ScenarioFile, name: str, choices: Choices) -> dict[str, Any]:
    """The plain tree of a flight: defaults of the parts, then the scenario's values, then the choices."""
    seed = file.seed if choices.seed is None else choices.seed
    duration = file.duration_s if choices.duration_s is None else choices.duration_s
    controller = choices.controller or file.controller
    onboard = merge(read_tree(CONFIG_DIRECTORY / "onboard.yaml"), {"guidance": _guidance(file, duration)})
    onboard = merge(onboard, _simulated_pilot(onboard))
    careful = read_tree(CONFIG_DIRECTORY / "real_vehicle.yaml") if choices.real else {}
    law = read_part("controllers", controller)
    onboard = merge(onboard, {"guidance": law.pop("guidance", {})})  # leads that were tuned with the controller
    features = read_tree(CONFIG_DIRECTORY / "features.yaml")
    onboard = merge(onboard, {"seed": seed, "controller": law})
    vehicle = read_vehicle(file.vehicle)
    onboard["airframe"] = vehicle.airframe
    simulated = merge(vehicle.simulated, {"disturbances": list(file.disturbances)})
    return {
        "scenario": name,
        "description": file.description,
        "controller": controller,
        "seed": seed,
        "duration_s": duration,
        "training_time_s": file.training_time_s,
        "experience": file.experience,
        "features": merge(features, law.pop("features", {})),
        "onboard": merge(merge(onboard, file.onboard), careful),
        "offboard": merge(merge(read_tree(CONFIG_DIRECTORY / "offboard.yaml"), {"seed": seed}), file.offboard),
        "vehicle": merge(simulated, file.vehicle_values),
        "radio": merge(read_part("radio", file.radio), file.radio_values),
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
