"""The resolved record of a flight: every value, checked; it goes into the flight folder, and each process reads its own
section of it. configs/flight_tree.py lays the files over one another.
"""

from collections.abc import Mapping
from typing import Annotated, Any, Final

import yaml
from pydantic import Field

from configs.addresses import Addresses
from configs.flight_tree import DEFAULT_SCENARIO, Choices, Duration, Seed, flight_tree
from configs.loader import ConfigRecord, fill
from configs.parts import named_file
from offboard.config import OffboardConfig
from onboard.config import OnboardConfig
from onboard.control.interface import LearningController
from protocol.feature_config import FeaturesConfig, with_features
from sim_vehicle.config import SimVehicleConfig
from sim_vehicle.link.radio import RadioConfig

COPIES: Final = {"onboard": {"features"}, "offboard": {"features"}}
"""What the records of both processes repeat of the flight's."""
__all__ = ["DEFAULT_SCENARIO", "Choices", "FlightConfig", "complete", "fill_flight", "resolve"]


class FlightConfig(ConfigRecord):
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
    features: FeaturesConfig
    onboard: OnboardConfig
    offboard: OffboardConfig
    vehicle: SimVehicleConfig
    radio: RadioConfig
    network: Addresses

    def to_yaml(self) -> str:
        """The record as YAML that the processes read back."""
        tree = self.model_dump(mode="json", by_alias=True, exclude=COPIES)
        return yaml.safe_dump(tree, sort_keys=False, allow_unicode=True, width=110)


def resolve(scenario: str = DEFAULT_SCENARIO, choices: Choices | None = None) -> FlightConfig:
    """The full record of a flight.

    Raises
    ------
    ConfigError
        Naming file, path, value and what is allowed.
    """
    return complete(*flight_tree(scenario, choices))


def complete(tree: Mapping[str, Any], source: str) -> FlightConfig:
    """The record of a flight's plain tree; an offboard side that nobody would learn from only relays the pose.

    Raises
    ------
    ConfigError
        Naming `source`, path, value and what is allowed.
    """
    flight = fill_flight(tree, source)
    _, and_set, assignments = source.partition(" --set ")
    law = f"{named_file('controllers', flight.controller)}{and_set}{assignments}"
    controller = flight.onboard.controller.build(flight.onboard.airframe, flight.features, flight.seed, law)
    learns = isinstance(controller, LearningController) and controller.accepts_features
    return flight if learns else _without_training(flight)


def fill_flight(tree: Mapping[str, Any], source: str) -> FlightConfig:
    """The record of a flight's plain tree. Raises ConfigError naming `source`, path, value and what is allowed."""
    return fill(FlightConfig, with_features(tree, source), source)


def _without_training(flight: FlightConfig) -> FlightConfig:
    """The same flight with an offboard side that relays the pose and learns nothing: no one would use it."""
    experience = flight.offboard.experience.model_copy(update={"mode": "frozen"})
    return flight.model_copy(update={"offboard": flight.offboard.model_copy(update={"experience": experience})})
