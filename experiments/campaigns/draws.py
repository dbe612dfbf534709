"""Random values of a campaign: drawn by the seed, and the same for all controllers.

A value is drawn with a generator of its own. A vehicle's values, and those of the campaign's own `draws`, get theirs by
seed and path: they are the same in every case. A value of a case gets its by seed and place in the case's list.
"""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Final, Self
from zlib import crc32

import numpy as np
from pydantic import Field, model_validator

from configs.flight_tree import read_scenario
from configs.loader import ConfigError, ConfigRecord
from configs.vehicle import RangeSet, Vehicle, read_vehicle
from protocol.conventions import GRAVITY

VEHICLE_ROOT: Final = "vehicle."
CASE_STREAM: Final = 401
CAMPAIGN_STREAM: Final = 402
VEHICLE_STREAM: Final = 403
DRAWN_TOGETHER: Final = ("body.mass_kg", "motors.gain")
"""Drawn again, both, until the vehicle has the thrust that is asked for."""
TRIES: Final = 1000


class Draw(ConfigRecord):
    """A random value for each seed, or a whole vehicle; the same for all controllers."""

    path: str = ""
    uniform: tuple[float, float] | None = None
    """Low and high."""
    choice: tuple[Any, ...] | None = None
    """One of these, with equal probability."""
    range: RangeSet | None = None
    """The range of this set that the vehicle's file gives for the value at `path`, which starts with `vehicle.`."""
    vehicle: RangeSet | None = None
    """Instead of a path: every value that the vehicle's file has a range for, within the ranges of this set."""
    thrust_to_weight: Annotated[float, Field(gt=0, le=3)] | None = None
    """With `vehicle`: least full thrust at the rated voltage by weight; mass and gain are drawn again until then."""

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        if [self.uniform, self.choice, self.range, self.vehicle].count(None) != 3:
            raise ValueError("give one of uniform, choice, range and vehicle")
        if (self.vehicle is None) is not bool(self.path):
            raise ValueError("path: expected with uniform, choice and range, and not with vehicle")
        if self.range is not None and not self.path.startswith(VEHICLE_ROOT):
            raise ValueError(f"path: {self.path!r}: expected one that starts with {VEHICLE_ROOT}, as range is given")
        if self.thrust_to_weight is not None and self.vehicle is None:
            raise ValueError("thrust_to_weight: expected with vehicle only")
        if self.uniform is not None and not self.uniform[0] < self.uniform[1]:
            raise ValueError(f"uniform: {list(self.uniform)}: expected the low end first, below the high one")
        return self

    def values(self, rng: np.random.Generator, seed: int, scenario: str) -> dict[str, Any]:
        """Draw for one seed; return each value by its path.

        rng: for a single value. A vehicle is drawn by `seed` alone.

        Raises
        ------
        ConfigError
            If the scenario's vehicle has no such range, or not that much thrust anywhere in its ranges.
        """
        if self.choice is not None:
            return {self.path: self.choice[int(rng.integers(len(self.choice)))]}
        if self.uniform is not None:
            return {self.path: round(float(rng.uniform(*self.uniform)), 6)}
        name = read_scenario(scenario).vehicle
        vehicle = read_vehicle(name)
        if self.range is not None:
            path = self.path.removeprefix(VEHICLE_ROOT)
            return {self.path: vehicle.drawn(path, float(rng.uniform()), self.range)}
        assert self.vehicle is not None
        drawn = _drawn_vehicle(vehicle, name, self.vehicle, self.thrust_to_weight, seed)
        return {VEHICLE_ROOT + path: value for path, value in drawn.items()}


def draw_all(common: Sequence[Draw], own: Sequence[Draw], seed: int, scenario: str) -> dict[str, Any]:
    """Draw the values of one seed of a case, each by its path.

    Parameters
    ----------
    common: draws of the campaign. own: draws of the case.

    Raises
    ------
    ConfigError
        As `Draw.values` does, and if a path is drawn twice.
    """
    drawn: dict[str, Any] = {}
    streams = [(one, [seed, CAMPAIGN_STREAM, crc32(one.path.encode())]) for one in common]
    streams += [(one, [seed, CASE_STREAM, index]) for index, one in enumerate(own)]
    for one, stream in streams:
        values = one.values(np.random.default_rng(stream), seed, scenario)
        if twice := [path for path in values if path in drawn]:
            raise ConfigError(f"draws: {twice[0]}: drawn twice; expected once, in the campaign or in the case")
        drawn |= values
    return drawn


def thrust_to_weight(body: Mapping[str, Any], motors: Mapping[str, Any]) -> float:
    """Full thrust of all motors at the rated voltage, as a multiple of the weight.

    body, motors: these sections of a vehicle.
    """
    return float(sum(motors["gain"]) * motors["max_thrust_n"] / (body["mass_kg"] * GRAVITY))


def _drawn_vehicle(vehicle: Vehicle, name: str, chosen: RangeSet, least: float | None, seed: int) -> dict[str, Any]:
    """Every value of the set of ranges, drawn by the seed: by path in the vehicle."""
    if not vehicle.ranges[chosen]:
        raise ConfigError(f"vehicle {name}: draws: vehicle: {chosen}: its file has no {chosen} ranges")

    def drawn(path: str, number: int) -> Any:
        rng = np.random.default_rng([seed, VEHICLE_STREAM, crc32(path.encode()), number])
        return vehicle.drawn(path, float(rng.uniform()), chosen)

    values = {path: drawn(path, 0) for path in vehicle.ranges[chosen]}
    for number in range(1, TRIES):
        if least is None or _thrust_to_weight(vehicle, values) >= least:
            return values
        values |= {path: drawn(path, number) for path in DRAWN_TOGETHER if path in values}
    raise ConfigError(
        f"vehicle {name}: draws: thrust_to_weight: {least:g}: no vehicle within its {chosen} ranges reaches it"
    )


def _thrust_to_weight(vehicle: Vehicle, values: Mapping[str, Any]) -> float:
    body, motors = vehicle.simulated["body"], vehicle.simulated["motors"]
    changed = {path.partition(".")[2]: value for path, value in values.items() if path in DRAWN_TOGETHER}
    return thrust_to_weight(body | changed, motors | changed)
