"""The shape of a record: a topic and its named fields with units. A record itself is a time and a flat vector."""

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class RecordType:
    """A kind of record in a flight log.

    Raises ValueError on construction when a field stands twice.
    """

    topic: str
    """For example "onboard/tick"."""
    fields: tuple[tuple[str, str], ...]
    """(name, unit) in the order of the vector; the unit "" means a pure number."""

    def __post_init__(self) -> None:
        names = [name for name, _ in self.fields]
        if len(set(names)) != len(names):
            raise ValueError(f"{self.topic}: a field stands twice")

    @property
    def names(self) -> tuple[str, ...]:
        """The fields' names."""
        return tuple(name for name, _ in self.fields)


def vector_fields(name: str, axes: str, unit: str) -> tuple[tuple[str, str], ...]:
    """Fields of a small vector, one for each character of `axes`: vector_fields("p", "ned", "m") -> p_n, p_e, p_d."""
    return tuple((f"{name}_{axis}", unit) for axis in axes)


CLOCK_OFFSET: Final = RecordType("onboard/clock_offset", (("offboard_minus_onboard", "ns"), ("round_trip", "ns")))
"""What onboard measured of offboard's clock, once a second; it errs by at most half the round trip."""
