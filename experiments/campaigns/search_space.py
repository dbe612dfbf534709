"""The space of a search: what its parameters are in the flight's configuration, their ranges, and steps in them."""

import math
from collections.abc import Sequence
from typing import Any, Final, Self

import numpy as np
from pydantic import Field, model_validator

from configs.loader import ConfigRecord
from experiments.flights.scenario import Choices, resolve

CONTROLLER_ROOT: Final = "onboard.controller."
GUIDANCE_ROOT: Final = "onboard.guidance."
END_SHARE: Final = 0.05
"""Share of a range, at either end, in which no best value should lie."""
STEP_SHARE: Final = (0.02, 0.12)
"""Least and greatest standard deviation of a step from the best values, as a share of each range."""


class Parameter(ConfigRecord):
    """One dimension of the search; `paths` are in the controller file, such as settings.position.gains.damping."""

    name: str
    paths: tuple[str, ...] = Field(min_length=1)
    """All of these get the value: settings..., or guidance... for lead times."""
    low: float
    high: float
    log: bool = False
    whole: bool = False
    """Whether the range is all that there is, as of a share: then a value at its end asks for no wider one."""

    @model_validator(mode="after")
    def _range(self) -> Self:
        if not self.low < self.high or (self.log and self.low <= 0.0):
            raise ValueError(f"{self.name}: low must be below high, and above 0 where log")
        return self

    def share(self, value: float) -> float:
        """Where a value lies in the range: 0 at the low end, 1 at the high end."""
        low, high, at = (math.log(one) if self.log else one for one in (self.low, self.high, value))
        return (at - low) / (high - low)

    def value(self, share: float) -> float:
        """The value at a share of the range, from 0 to 1."""
        low, high = (math.log(one) if self.log else one for one in (self.low, self.high))
        at = low + min(max(share, 0.0), 1.0) * (high - low)
        return min(max(math.exp(at) if self.log else at, self.low), self.high)


def assignments(space: Sequence[Parameter], values: dict[str, float]) -> dict[str, float]:
    """Return the values by path of the flight's resolved configuration."""
    return {_flight_path(path): values[one.name] for one in space for path in one.paths if one.name in values}


def _flight_path(path: str) -> str:
    if path.startswith("guidance."):
        return GUIDANCE_ROOT + path.removeprefix("guidance.")
    return CONTROLLER_ROOT + path


def present_values(space: Sequence[Parameter], controller: str) -> dict[str, float]:
    """Return the values of the controller's file and the defaults, limited to the ranges: the start of a search."""
    flight = resolve(choices=Choices(controller))
    settings = flight.onboard.controller.filled_settings(flight.features)
    tree = {"settings": settings.model_dump(mode="json"), "guidance": flight.onboard.guidance.model_dump(mode="json")}
    values = {}
    for parameter in space:
        node: Any = tree
        for key in parameter.paths[0].split("."):
            if isinstance(node, list):
                node = node[int(key)] if key.isdigit() and int(key) < len(node) else None
            else:
                node = node.get(key) if isinstance(node, dict) else None
        if isinstance(node, int | float) and not isinstance(node, bool):
            values[parameter.name] = min(max(float(node), parameter.low), parameter.high)
    return values


def step_from(space: Sequence[Parameter], values: dict[str, float], rng: np.random.Generator) -> dict[str, float]:
    """Values a random step away from these: about half of them changed, all by the same standard deviation."""
    low, high = STEP_SHARE
    sigma = low * (high / low) ** float(rng.uniform())
    chosen = rng.random(len(space)) < 0.5
    chosen[int(rng.integers(len(space)))] = True
    steps = sigma * rng.standard_normal(len(space)) * chosen
    return {
        one.name: one.value(one.share(values[one.name]) + step) if step else values[one.name]
        for one, step in zip(space, steps.tolist(), strict=True)
    }


def shares(space: Sequence[Parameter], values: dict[str, float]) -> list[float]:
    """Where the values lie in their ranges."""
    return [one.share(values[one.name]) for one in space]


def values_at(space: Sequence[Parameter], point: Sequence[float]) -> dict[str, float]:
    """The values at these shares of their ranges."""
    return {one.name: one.value(share) for one, share in zip(space, point, strict=True)}


def near_an_end(space: Sequence[Parameter], values: dict[str, float]) -> list[str]:
    """Names of the parameters whose value lies within END_SHARE of an end of a range that could be wider."""
    return [
        one.name for one in space if not one.whole and not END_SHARE <= one.share(values[one.name]) <= 1.0 - END_SHARE
    ]
