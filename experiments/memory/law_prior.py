"""The spread of W about theta that the law on board assumes: the S0 of a memory, which has no value of its own."""

from collections.abc import Mapping
from functools import cache
from typing import Any, Final, NamedTuple

from configs.parts import read_part

DEFAULT_CONTROLLER: Final = "dmrac"
"""Flies with a memory if the flights that taught it say nothing about it."""


class Spreads(NamedTuple):
    """Of each of a condition's weights about theta."""

    position_m_s2: float
    attitude_rad_s2: float


def law_spreads(settings: Mapping[str, Any]) -> Spreads | None:
    """The spreads in a controller's settings, or None if a channel's law has no prior."""
    found = []
    for channel in Spreads._fields:
        place: Any = settings
        for key in (channel.split("_")[0], "augmentation", "law", "prior"):
            place = place.get(key) if isinstance(place, Mapping) else None
        if not isinstance(place, int | float) or not place > 0.0:
            return None
        found.append(float(place))
    return Spreads(*found)


@cache
def default_spreads() -> Spreads:
    """Those of the controller that a memory is made for."""
    found = law_spreads(read_part("controllers", DEFAULT_CONTROLLER)["settings"])
    assert found is not None
    return found
