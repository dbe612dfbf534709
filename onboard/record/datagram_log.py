"""The datagram log: every datagram in and out of the core, tick by tick, so that a flight can be run again exactly.

One record a tick, written after the step: a head (time, number of the tick, missed ticks, whether the step failed),
then entries in the order in which they happened: the kind (one byte), the length (two bytes), the age at the tick's
time (eight bytes, ns) and the bytes. Whoever
drives a core (the real-time process, lockstep) fills a `DatagramLogWriter`; `experiments.replays.replay_check` feeds
what it holds to a fresh core. A datagram log holds what was on the wires, and no key.
"""

import struct
from collections.abc import Iterator, Sequence
from enum import IntEnum
from typing import Final, NamedTuple

from protocol.arrival import Arrival

TOPIC: Final = "onboard/datagrams"
HEAD: Final = struct.Struct("<qIIB")
ENTRY: Final = struct.Struct("<BHq")
ENTRY_MAX_BYTES: Final = 0xFFFF


class Entry(IntEnum):
    """What an entry is; values are on disk."""

    FROM_VEHICLE = 1
    FROM_OFFBOARD = 2
    FROM_GROUND = 3
    LAND_REQUEST = 4
    """The process is asked to end; no bytes."""
    TO_VEHICLE = 5
    TO_OFFBOARD = 6
    TO_GROUND = 7


class LoggedTick(NamedTuple):
    """One record read back."""

    now_ns: int
    number: int
    """Counts the records of a log from 0; a jump means that the log lost some."""
    missed_ticks: int
    failed: bool
    """The tick raised, and the safe output was sent instead."""
    entries: tuple[tuple[Entry, Arrival], ...]

    def of(self, kind: Entry) -> list[bytes]:
        """The datagrams of one kind."""
        return [arrival.datagram for arrival in self.arrivals(kind)]

    def arrivals(self, kind: Entry) -> list[Arrival]:
        """The datagrams of one kind with their ages."""
        return [arrival for entry, arrival in self.entries if entry is kind]


class DatagramLogWriter:
    """Gathers one tick's entries."""

    __slots__ = ("_number", "_parts")

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._number = 0

    def put(self, kind: Entry, datagrams: Sequence[bytes | Arrival]) -> None:
        """Add datagrams of one kind to the current tick. Plain bytes have age 0."""
        for one in datagrams:
            datagram, age_ns = one if isinstance(one, Arrival) else (one, 0)
            self._parts.append(ENTRY.pack(kind, len(datagram), age_ns))
            self._parts.append(datagram)

    def land_request(self) -> None:
        """Add the request to land."""
        self.put(Entry.LAND_REQUEST, [b""])

    def end_tick(self, now_ns: int, missed_ticks: int, failed: bool = False) -> bytes:
        """The record of the tick; the next entry belongs to the next one."""
        parts, self._parts = self._parts, []
        record = HEAD.pack(now_ns, self._number, missed_ticks, failed) + b"".join(parts)
        self._number += 1
        return record


def read_tick(record: bytes) -> LoggedTick:
    """A record read back.

    Raises
    ------
    ValueError
        If it is not one.
    """
    try:
        now_ns, number, missed, failed = HEAD.unpack_from(record)
        return LoggedTick(now_ns, number, missed, bool(failed), tuple(_entries(record)))
    except struct.error as error:
        raise ValueError(f"not a record of a datagram log: {error}") from None


def _entries(record: bytes) -> Iterator[tuple[Entry, Arrival]]:
    at = HEAD.size
    while at < len(record):
        kind, length, age_ns = ENTRY.unpack_from(record, at)
        start = at + ENTRY.size
        at = start + length
        if at > len(record):
            raise ValueError("a record of a datagram log that ends too early")
        yield Entry(kind), Arrival(record[start:at], age_ns)
