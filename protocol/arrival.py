"""A datagram with its age: how a process tells its core when a datagram arrived."""

from collections.abc import Sequence
from typing import NamedTuple


class Arrival(NamedTuple):
    """A datagram and how long before the step's `now` it arrived."""

    datagram: bytes
    age_ns: int = 0


Datagrams = Sequence[bytes | Arrival]
"""What a step receives; plain bytes arrived at its `now`."""


def at_times(datagrams: Datagrams, now_ns: int) -> Sequence[tuple[bytes, int]]:
    """Each datagram and the time of its arrival. Plain bytes arrived at `now_ns`."""
    if not datagrams:
        return ()
    return [(one.datagram, now_ns - one.age_ns) if isinstance(one, Arrival) else (one, now_ns) for one in datagrams]
