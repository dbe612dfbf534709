"""Reads a vehicle's one description, configs/vehicles/NAME.yaml, for the simulator, for onboard and for draws.

The sections `body`, `motors`, `battery` and so on hold the nominal values. Four more sections may stand beside them:

    simulated:         values of the simulated vehicle that are not the nominal ones
    onboard:           how onboard drives the motors of this vehicle
    ranges:            how far a value may differ from one vehicle of this kind to the next, by the path of the value;
                       the gains of the controllers are tuned in these
    held_out_ranges:   other ranges of the same values, for vehicles that nobody tuned for
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal, Self

from pydantic import Field, model_validator

from configs.loader import ConfigError, ConfigRecord, fill, merge
from configs.parts import named_file, read_part

AIRFRAME: Final = {
    "mass_kg": "body.mass_kg",
    "inertia_kg_m2": "body.inertia_kg_m2",
    "arm_x_m": "body.arm_x_m",
    "arm_y_m": "body.arm_y_m",
    "yaw_torque_per_thrust_m": "motors.torque_ratio_m",
    "motor_thrust_max_n": "motors.max_thrust_n",
    "motor_lag_up_s": "motors.lag_up_s",
    "motor_lag_down_s": "motors.lag_down_s",
}
"""Keys of `onboard.airframe`, each with the path of the nominal value that it gets."""
RangeSet = Literal["tuning", "held_out"]
"""`ranges` and `held_out_ranges`."""


class Range(ConfigRecord):
    """Where a value lies from one vehicle to the next: low and high. All elements of a list move together."""

    between: tuple[float, float] | None = Field(default=None, description="in the unit of the value")
    times: tuple[float, float] | None = Field(default=None, description="factors of the vehicle's own value")

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        if (self.between is None) == (self.times is None):
            raise ValueError("give either between or times")
        low, high = self.between or self.times or (0.0, 0.0)
        if not low < high:
            raise ValueError(f"{low:g} to {high:g}: expected the low end first, below the high one")
        return self

    def value(self, own: Any, share: float) -> Any:
        """The value at `share` of the range, from 0 to 1; own: the vehicle's value, a number or a list of numbers."""
        if isinstance(own, list):
            return [self.value(one, share) for one in own]
        low, high = self._bounds(own)
        return float(f"{low + share * (high - low):.6g}")

    def holds(self, own: Any) -> bool:
        """Whether the vehicle's own value lies in its range."""
        if isinstance(own, list):
            return all(self.holds(one) for one in own)
        low, high = self._bounds(own)
        return bool(low <= own <= high)

    def _bounds(self, own: float) -> tuple[float, float]:
        if self.between is not None:
            return self.between
        assert self.times is not None
        return self.times[0] * own, self.times[1] * own


class _Ranges(ConfigRecord):
    ranges: dict[str, Range] = Field(default_factory=dict)
    held_out_ranges: dict[str, Range] = Field(default_factory=dict)


@dataclass(frozen=True)
class Vehicle:
    """A vehicle's description."""

    simulated: dict[str, Any]
    """The plain tree of the simulated vehicle, with the nominal body and motors in `nominal`."""
    airframe: dict[str, Any]
    """The plain tree of `onboard.airframe`."""
    ranges: dict[RangeSet, dict[str, Range]]
    """By path in `simulated`."""

    def drawn(self, path: str, share: float, chosen: RangeSet) -> Any:
        """The value at `share` of a range, from 0 to 1. Raises ConfigError if the vehicle has no such range."""
        ranges = self.ranges[chosen]
        if path not in ranges:
            allowed = f"allowed are {', '.join(ranges)}" if ranges else "it has none at all"
            raise ConfigError(f"{path}: the vehicle has no {chosen} range of it; {allowed}")
        return ranges[path].value(value_at(self.simulated, path), share)


def read_vehicle(name: str) -> Vehicle:
    """The description of a vehicle by its name in configs/vehicles, or by its file.

    Raises
    ------
    ConfigError
        If a file cannot be read, a range is of no value of the vehicle, or one of `ranges` does not hold its value.
    """
    nominal = read_part("vehicles", name)
    source = str(named_file("vehicles", name))
    simulated, onboard = (_section(nominal, key, source) for key in ("simulated", "onboard"))
    keys = ("ranges", "held_out_ranges")
    filled = fill(_Ranges, {key: nominal.pop(key) for key in keys if key in nominal}, source)
    assumed = {key: nominal[key] for key in ("body", "motors") if key in nominal}
    values = {key: value_at(nominal, path) for key, path in AIRFRAME.items()}
    tree = merge(merge(nominal, simulated), {"nominal": assumed})
    for path, one in filled.ranges.items():
        own = value_at(tree, path)
        if own is None or not one.holds(own):
            raise ConfigError(f"{source}: ranges.{path}: does not hold the vehicle's own value, {own}")
    for path in filled.held_out_ranges:
        if path not in filled.ranges:
            allowed = f"allowed are the paths of ranges: {', '.join(filled.ranges)}"
            raise ConfigError(f"{source}: held_out_ranges.{path}: unknown path; {allowed}")
    ranges: dict[RangeSet, dict[str, Range]] = {"tuning": filled.ranges, "held_out": filled.held_out_ranges}
    return Vehicle(tree, {key: value for key, value in values.items() if value is not None} | onboard, ranges)


def value_at(tree: Mapping[str, Any], path: str) -> Any:
    """The value at a path of a plain tree; None if there is none."""
    node: Any = tree
    for key in path.split("."):
        node = node.get(key) if isinstance(node, Mapping) else None
    return node


def _section(tree: dict[str, Any], key: str, source: str) -> dict[str, Any]:
    section = tree.pop(key, {})
    if not isinstance(section, dict):
        raise ConfigError(f"{source}: {key}: {section!r}: expected a mapping of keys")
    return section
