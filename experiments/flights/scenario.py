"""The resolved record of a flight: every value, checked. configs/flight_tree.py composes its plain tree.

The record is written into the flight folder, and each process reads its own section of it.
"""

from collections.abc import Mapping
from typing import Annotated, Any, Final

from pydantic import Field

from configs.addresses import Addresses
from configs.flight_tree import (
    DEFAULT_SCENARIO,
    FEATURES_FILE,
    GUIDANCE_FILE,
    Choices,
    Duration,
    Seed,
    flight_tree,
)
from configs.loader import ConfigRecord, fill, read_tree
from configs.marked_yaml import default_paths, equal_paths, marked_yaml
from configs.parts import named_file
from offboard.config import OffboardConfig
from onboard.config import OnboardConfig
from onboard.control.interface import LearningController
from protocol.feature_config import FeaturesConfig, with_features
from sim_vehicle.config import SimVehicleConfig
from sim_vehicle.link.radio import RadioConfig

COPIES: Final = {"onboard": {"features"}, "offboard": {"features"}}
"""The copies of `features` that both processes hold; they are not written."""
POSE_WAIT_S: Final = 4.0
"""Wait for a pose that may never come. In this time at rest the gyroscope's bias is found."""
__all__ = ["DEFAULT_SCENARIO", "Choices", "FlightConfig", "complete", "fill_flight", "resolve", "with_pose_wait"]


class FlightConfig(ConfigRecord):
    """All settings of one flight, resolved."""

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
        """The record as YAML that the processes read back, with a comment behind every default value."""
        tree = self.model_dump(mode="json", by_alias=True, exclude=COPIES)
        usual = {"features": read_tree(FEATURES_FILE), "onboard": {"guidance": read_tree(GUIDANCE_FILE)}}
        settings = self.onboard.controller.filled_settings(self.features)
        defaults = {*default_paths(self), *default_paths(settings, at="onboard.controller.settings.")}
        return marked_yaml(tree, defaults | set(equal_paths(tree, usual)))


def resolve(scenario: str = DEFAULT_SCENARIO, choices: Choices | None = None) -> FlightConfig:
    """The resolved record of a scenario with the choices of the command line.

    Raises
    ------
    ConfigError
        Naming file, path, value and what is allowed.
    """
    has_file = choices is None or choices.law is None
    return complete(*flight_tree(scenario, choices), has_file)


def complete(tree: Mapping[str, Any], source: str, has_file: bool = True) -> FlightConfig:
    """The resolved record of a flight's plain tree. If the controller cannot use features, offboard learns nothing.

    has_file: whether the controller has a file, which a message then names.

    Raises
    ------
    ConfigError
        Naming `source`, path, value and what is allowed.
    """
    flight = fill_flight(tree, source)
    _, and_set, assignments = source.partition(" --set ")
    law = f"{named_file('controllers', flight.controller) if has_file else flight.controller}{and_set}{assignments}"
    completed = flight.onboard.controller.completed(flight.features, law)
    flight = flight.model_copy(update={"onboard": flight.onboard.model_copy(update={"controller": completed})})
    controller = completed.build(flight.onboard.airframe, flight.features, flight.seed, law)
    learns = isinstance(controller, LearningController) and controller.accepts_features
    return flight if learns else _without_training(flight)


def with_pose_wait(flight: FlightConfig) -> FlightConfig:
    """The same flight, in which arming waits POSE_WAIT_S for a first pose, unless its configuration says how long.

    For flights in which no pose ever comes: without the offboard side, or with a dead link.
    """
    if flight.onboard.pose_wait_s is not None:
        return flight
    return flight.model_copy(update={"onboard": flight.onboard.model_copy(update={"pose_wait_s": POSE_WAIT_S})})


def fill_flight(tree: Mapping[str, Any], source: str) -> FlightConfig:
    """The record of a flight's plain tree. Raises ConfigError naming `source`, path, value and what is allowed."""
    return fill(FlightConfig, with_features(tree, source), source)


def _without_training(flight: FlightConfig) -> FlightConfig:
    """The same flight with an offboard side that relays the pose and learns nothing."""
    experience = flight.offboard.experience.model_copy(update={"mode": "frozen"})
    return flight.model_copy(update={"offboard": flight.offboard.model_copy(update={"experience": experience})})
