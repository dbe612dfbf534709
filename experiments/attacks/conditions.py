"""The air and the vehicle in which a bad learner is flown: still air, the jet, and the jet with a chipped rotor."""

import json
from typing import Any, Final

from configs.loader import ConfigError
from experiments.flights.scenario import Choices, resolve

AS_CONFIGURED: Final = "scenario"
"""The scenario's own disturbances."""
CHIP_ONSET_S: Final = 6.0
"""s of flight, on the path and shortly before the attack (experiments.attacks.attack_flight)."""
CHIP: Final[dict[str, Any]] = {"kind": "rotor_chip", "thrust_factor": 0.75, "onset_s": CHIP_ONSET_S}
JET_M_S: Final[dict[str, float]] = {"calm": 0.0, "jet_4": 4.0, "jet_8": 8.0, "chip": 8.0}
"""Speed of every fan jet of the scenario. In `calm` no other disturbance is left."""
CONDITIONS: Final = (AS_CONFIGURED, *JET_M_S)


def condition_assignments(name: str, scenario: str) -> tuple[str, ...]:
    """The assignments of a condition in a scenario. Raises ConfigError: unknown name, or a scenario without a jet."""
    if name not in CONDITIONS:
        raise ConfigError(f"--condition: {name!r} unknown; allowed are {', '.join(CONDITIONS)}")
    if name == AS_CONFIGURED:
        return ()
    vehicle = resolve(scenario, Choices()).vehicle.model_dump(mode="json", by_alias=True)
    disturbances: list[dict[str, Any]] = vehicle["disturbances"]
    if not any(one["kind"] == "fan_jet" for one in disturbances):
        raise ConfigError(
            f"--condition: {name!r} sets the speed of a fan_jet, and scenario {scenario} has none;"
            f" allowed is {AS_CONFIGURED}, or a scenario with one, such as figure8_wind"
        )
    jet = {"speed_m_s": JET_M_S[name]}
    changed = [one | jet if one["kind"] == "fan_jet" else one for one in disturbances if name != "calm"]
    if name == "chip":
        changed.append(CHIP)
    return (f"vehicle.disturbances={json.dumps(changed)}",)
