"""How a replayed tick is compared with the logged one: bit for bit, or, with another core, by what it decides."""

from collections.abc import Iterator
from typing import Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from flight_log.log_file import LogFile
from onboard.core import OnboardOutput
from onboard.record.datagram_log import Entry, LoggedTick
from onboard.record.tick import OFFSET, TICK

Row = NDArray[np.float64]
"""Per onboard.record.tick.TICK."""
OUTPUTS: Final = (
    (Entry.TO_VEHICLE, "motor datagram", "to_vehicle"),
    (Entry.TO_OFFBOARD, "datagram to offboard", "to_offboard"),
    (Entry.TO_GROUND, "datagram to the ground station", "to_ground"),
)
MOTOR_DIFFERENCE_MAX: Final = {"double": 1e-7, "float": 2e-3}
"""Of motor commands of two cores, as a share of the maximum thrust, by the precision of the C core; a motor datagram
holds no step smaller than 1e-7."""
DECISIONS: Final = ("mode", "adapting", "saturated", "feature_version", "law")
"""Fields of a tick record that hold a decision."""
MOTORS: Final = slice(OFFSET["motor_1"], OFFSET["motor_4"] + 1)


class Finding(NamedTuple):
    """The first difference in a tick."""

    field: str
    logged: str
    replayed: str


class Judge(Protocol):
    """Compares tick by tick."""

    motor_difference: float
    """Largest so far of those that are allowed, as a share of the maximum thrust."""

    def compare(self, tick: LoggedTick, row: Row | None, output: OnboardOutput) -> Finding | None:
        """The first difference. row: the logged tick record, if there is one."""

    def at_end(self) -> Finding | None:
        """What is missing after the last tick of a complete log."""

    @property
    def verdict(self) -> str:
        """What a flight without difference has shown."""


class SameBits:
    """The same core must give the same bits."""

    verdict = "equal bit for bit"
    motor_difference = 0.0

    def __init__(self, log: LogFile) -> None:
        self._kind = _kind(log)

    def compare(self, tick: LoggedTick, row: Row | None, output: OnboardOutput) -> Finding | None:
        """Tick record, in the bits that the log has of it, and datagrams."""
        if row is not None:
            found = _first_field(row, _as_logged(output.tick, self._kind))
            if found is not None:
                return found
        for kind, name, attribute in OUTPUTS:
            found = _first_datagram(name, tick.of(kind), getattr(output, attribute))
            if found is not None:
                return found
        return None

    def at_end(self) -> Finding | None:
        """Nothing: each tick was compared completely."""
        return None


class SameDecisions:
    """Another core rounds differently: it must decide the same, and command the same but for rounding."""

    def __init__(self, log: LogFile, motor_difference_max: float) -> None:
        self._logged = _events(log)
        self._kind = _kind(log)
        self._allowed = motor_difference_max
        self.motor_difference = 0.0

    @property
    def verdict(self) -> str:
        """With the largest difference of a motor command."""
        largest = f"motor commands within {self.motor_difference:.1e} of full scale"
        return f"the same modes, events, feature versions and numbers of datagrams, {largest}"

    def compare(self, tick: LoggedTick, row: Row | None, output: OnboardOutput) -> Finding | None:
        """Events, numbers of datagrams, decisions, motor commands."""
        for event in output.events:
            logged = next(self._logged, None)
            if event != logged:
                return Finding("event", _shown(logged), _shown(event))
        for kind, name, attribute in OUTPUTS:
            numbers = len(tick.of(kind)), len(getattr(output, attribute))
            if numbers[0] != numbers[1]:
                return Finding(f"number of {name}s", *map(str, numbers))
        return None if row is None else self._compare_rows(row, _as_logged(output.tick, self._kind))

    def _compare_rows(self, logged: Row, replayed: Row) -> Finding | None:
        for name in DECISIONS:
            numbers = logged[OFFSET[name]], replayed[OFFSET[name]]
            if numbers[0] != numbers[1]:
                return Finding(f"{TICK.topic} {name}", *(f"{number:g}" for number in numbers))
        apart = np.abs(logged[MOTORS] - replayed[MOTORS])
        worst = int(apart.argmax())
        if not apart[worst] <= self._allowed:
            numbers = logged[MOTORS][worst], replayed[MOTORS][worst]
            return Finding(f"{TICK.topic} motor_{worst + 1}", *(repr(float(number)) for number in numbers))
        self.motor_difference = max(self.motor_difference, float(apart[worst]))
        return None

    def at_end(self) -> Finding | None:
        """An event that was logged, and did not happen."""
        left = next(self._logged, None)
        return None if left is None else Finding("event", _shown(left), _shown(None))


def _kind(log: LogFile) -> str:
    """In which numbers a log has its tick records."""
    topic = log.vectors.get(TICK.topic)
    return TICK.kind if topic is None else topic.record_type.kind


def _as_logged(row: Row, kind: str) -> Row:
    """A row as the log gives it back."""
    return row.astype(kind).astype(np.float64)


def _events(log: LogFile) -> Iterator[tuple[int, str]]:
    """The logged events of the core; the process's report of a tick that raised is none."""
    events = (event for texts in log.texts.values() for event in texts)
    return (event for event in events if not event[1].startswith("Traceback"))


def _shown(event: tuple[int, str] | None) -> str:
    return "none" if event is None else repr(event[1])


def _first_field(logged: Row, replayed: Row) -> Finding | None:
    differs = np.flatnonzero(logged.view(np.int64) != replayed.view(np.int64))
    if not differs.size:
        return None
    first = int(differs[0])
    more = f" (and {differs.size - 1} more fields)" if differs.size > 1 else ""
    numbers = repr(float(logged[first])), repr(float(replayed[first])) + more
    return Finding(f"{TICK.topic} {TICK.names[first]}", *numbers)


def _first_datagram(name: str, logged: list[bytes], replayed: list[bytes]) -> Finding | None:
    if len(logged) != len(replayed):
        return Finding(f"number of {name}s", str(len(logged)), str(len(replayed)))
    for ours, theirs in zip(logged, replayed, strict=True):
        if ours != theirs:
            at = next((i for i, (a, b) in enumerate(zip(ours, theirs, strict=False)) if a != b), len(ours))
            shown = (datagram[at : at + 8].hex() or "nothing" for datagram in (ours, theirs))
            return Finding(f"{name}, byte {at}", *shown)
    return None
