"""Record types: a topic and its fields with units. A record is a time and a flat vector of these fields."""

from dataclasses import dataclass
from typing import Final, Literal


@dataclass(frozen=True, slots=True)
class RecordType:
    """A type of record in a flight log.

    Raises ValueError on construction if a field occurs twice.
    """

    topic: str
    """For example "onboard/tick"."""
    fields: tuple[tuple[str, str], ...]
    """(name, unit) in the order of the vector; the unit is "" for a pure number."""
    kind: Literal["float64", "float32"] = "float64"
    """In the log. float32 has 7 digits in half the space: for records of every tick without times in ns."""

    def __post_init__(self) -> None:
        names = [name for name, _ in self.fields]
        if len(set(names)) != len(names):
            raise ValueError(f"{self.topic}: a field occurs twice")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the fields."""
        return tuple(name for name, _ in self.fields)


def vector_fields(name: str, axes: str, unit: str) -> tuple[tuple[str, str], ...]:
    """Fields of a small vector, one for each character of `axes`: vector_fields("p", "ned", "m") -> p_n, p_e, p_d."""
    return tuple((f"{name}_{axis}", unit) for axis in axes)


CLOCK_OFFSET: Final = RecordType("onboard/clock_offset", (("offboard_minus_onboard", "ns"), ("round_trip", "ns")))
"""Offset of offboard's clock as measured by onboard, once a second; its error is at most half the round trip."""
