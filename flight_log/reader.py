"""Reads a flight: numpy columns with units, events and metadata of all its processes, on one time base.

>>> flight = open_flight(Path("flights/20260101_120000_figure8_wind"))    # doctest: +SKIP
>>> tick = flight["onboard/tick"]                                         # doctest: +SKIP
>>> tick["position_n"], tick.units["position_n"], tick.seconds(flight.start_ns)   # doctest: +SKIP

A flight is a folder with one log per process (`onboard.mcap` ...), or a single log file. Logs of killed processes
are read up to their last complete chunk; `flight.faults` and `flight.gaps` list what is missing.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from flight_log.clocks import ClockMap, clock_map
from flight_log.log_file import FlightError, LogFile, VectorTopic, read_log_file

__all__ = ["Event", "Flight", "FlightError", "Gap", "Table", "open_flight"]

PayloadT = TypeVar("PayloadT")

TICK_TOPIC: Final = "onboard/tick"
GAP_MIN_NS: Final = 100_000_000
"""A topic of regular rate has a gap where it is silent for longer than this and than GAP_PERIODS of its periods."""
GAP_PERIODS: Final = 10
REGULAR_RECORDS_MIN: Final = 20
MERGED: Final = "merged"
"""Process name of a file with the merged logs of all processes."""


@dataclass(frozen=True, slots=True)
class Table:
    """All records of a topic."""

    topic: str
    names: tuple[str, ...]
    units: dict[str, str]
    """Column -> unit; "" for a pure number."""
    time_ns: NDArray[np.int64]
    """[n], common time base of the flight."""
    values: NDArray[np.float64]
    """[n, columns]"""

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        """A column, [n]. Raises KeyError, which lists the columns."""
        try:
            return self.values[:, self.names.index(name)]
        except ValueError:
            raise KeyError(f"{self.topic} has no column {name!r}; it has {', '.join(self.names)}") from None

    def __contains__(self, name: str) -> bool:
        return name in self.names

    def __len__(self) -> int:
        return len(self.time_ns)

    @property
    def columns(self) -> dict[str, NDArray[np.float64]]:
        """All columns by name, [n] each."""
        return {name: self.values[:, index] for index, name in enumerate(self.names)}

    def vector(self, *names: str) -> NDArray[np.float64]:
        """The named columns side by side, [n, len(names)]."""
        return np.column_stack([self[name] for name in names])

    def seconds(self, start_ns: int) -> NDArray[np.float64]:
        """[n], s since `start_ns`."""
        return (self.time_ns - start_ns).astype(np.float64) * 1e-9


@dataclass(frozen=True, slots=True)
class Event:
    """An event, as text."""

    time_ns: int
    process: str
    text: str


@dataclass(frozen=True, slots=True)
class Gap:
    """A time span without records."""

    topic: str
    start_ns: int
    end_ns: int
    lost: int
    """Records given to the log that are not in it; 0 if the process was silent."""

    def describe(self, start_ns: int) -> str:
        """The gap as a line of text; times relative to `start_ns`."""
        begin, end = (self.start_ns - start_ns) * 1e-9, (self.end_ns - start_ns) * 1e-9
        what = f"{self.lost} records lost" if self.lost else "silent"
        return f"{self.topic}: {what} from {begin:.3f} s to {end:.3f} s"


class Flight:
    """The logs of a flight, as `open_flight` reads them. Tables are built when first used."""

    def __init__(self, path: Path, logs: tuple[LogFile, ...]) -> None:
        self.path = path
        self.logs = logs
        maps = [clock_map(log, logs) for log in logs]
        self._maps: tuple[ClockMap, ...] = tuple(found for found, _ in maps)
        self._warnings = tuple(warning for _, warning in maps if warning)
        self._tables: dict[str, Table] = {}

    @cached_property
    def topics(self) -> tuple[str, ...]:
        """Topics with numeric records."""
        return tuple(sorted({topic for log in self.logs for topic in log.vectors}))

    @cached_property
    def byte_topics(self) -> tuple[str, ...]:
        """Topics with raw bytes."""
        return tuple(sorted({topic for log in self.logs for topic in log.raw}))

    @property
    def processes(self) -> tuple[str, ...]:
        """Names of the processes that logged."""
        return tuple(dict.fromkeys(log.process for log in self.logs))

    @property
    def metadata(self) -> dict[str, dict[str, str]]:
        """Process -> its metadata (of the latest run, if it was restarted)."""
        return {log.process: log.metadata for log in self.logs}

    @property
    def attachments(self) -> dict[str, dict[str, bytes]]:
        """Process -> attached files by name."""
        return {log.process: log.attachments for log in self.logs}

    @cached_property
    def summary(self) -> dict[str, Any]:
        """The flight summary, `summary.json`; empty if there is none. Raises FlightError if it is not JSON."""
        file = (self.path if self.path.is_dir() else self.path.parent) / "summary.json"
        if not file.exists():
            return {}
        try:
            found = json.loads(file.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise FlightError(f"{file}: not a flight summary: {error}") from None
        return found if isinstance(found, dict) else {}

    def __contains__(self, topic: str) -> bool:
        return topic in self.topics

    def __iter__(self) -> Iterator[Table]:
        return (self[topic] for topic in self.topics)

    def __getitem__(self, topic: str) -> Table:
        """The table of a topic. Raises KeyError, which lists the topics."""
        if topic not in self._tables:
            self._tables[topic] = self._build(topic)
        return self._tables[topic]

    def get(self, topic: str) -> Table | None:
        """The table of a topic, or None."""
        return self[topic] if topic in self.topics else None

    def messages(self, topic: str) -> list[tuple[int, bytes]]:
        """(time in ns, bytes) of each record of a byte topic, in the order of writing. Raises KeyError."""
        if topic not in self.byte_topics:
            raise KeyError(f"{self.path} has no bytes of {topic!r}; it has {', '.join(self.byte_topics) or 'none'}")
        found = []
        for log, to_base in zip(self.logs, self._maps, strict=True):
            found += _on_base(log.raw.get(topic, []), to_base)
        return found

    @cached_property
    def events(self) -> tuple[Event, ...]:
        """The events of all processes, in order of time."""
        found = []
        for log, to_base in zip(self.logs, self._maps, strict=True):
            texts = [message for messages in log.texts.values() for message in messages]
            found += [Event(time_ns, log.process, text) for time_ns, text in _on_base(texts, to_base)]
        return tuple(sorted(found, key=lambda event: event.time_ns))

    @cached_property
    def start_ns(self) -> int:
        """Time of t = 0: onboard's first tick, or the first record if onboard logged no tick.

        Records of other processes before it have negative times.
        """
        tick = self.get(TICK_TOPIC)
        return self.first_ns if tick is None else int(tick.time_ns[0])

    @cached_property
    def first_ns(self) -> int:
        """Time of the first record."""
        return min(self._ends)

    @cached_property
    def end_ns(self) -> int:
        """Time of the last record."""
        return max(self._ends)

    @property
    def duration_s(self) -> float:
        """From t = 0 to the last record."""
        return (self.end_ns - self.start_ns) * 1e-9

    @cached_property
    def _ends(self) -> list[int]:
        """Times of the first and the last record of each table, and of all events; 0 where there are none."""
        ends = [int(time_ns) for table in self for time_ns in (table.time_ns[0], table.time_ns[-1])]
        return [*ends, *(event.time_ns for event in self.events)] or [0]

    @cached_property
    def gaps(self) -> tuple[Gap, ...]:
        """The gaps in all topics."""
        found = []
        for log, to_base in zip(self.logs, self._maps, strict=True):
            for name, topic in log.vectors.items():
                found += _gaps(name, topic, to_base)
        return tuple(sorted(found, key=lambda gap: gap.start_ns))

    @cached_property
    def faults(self) -> tuple[str, ...]:
        """Faults of the logs, one line each; `gaps` is separate."""
        found = list(self._warnings)
        for log, to_base in zip(self.logs, self._maps, strict=True):
            last = self._last_record(log, to_base)
            if log.damage:
                found.append(f"{log.path.name}: {log.damage}; everything after {last} is lost")
            elif not log.complete:
                found.append(f"{log.path.name}: not closed (killed, still flying, or disk full); read up to {last}")
            if log.record_count == 0:
                found.append(f"{log.path.name}: contains no records")
        return tuple(found)

    def _last_record(self, log: LogFile, to_base: ClockMap) -> str:
        """The time of a log's last record, as text."""
        last_ns = max((int(topic.times_ns[-1]) for topic in log.vectors.values()), default=None)
        if last_ns is None:
            return "its last chunk"
        time_ns = int(to_base(np.array([last_ns], dtype=np.int64))[0])
        return f"{(time_ns - self.start_ns) * 1e-9:.3f} s"

    def _build(self, topic: str) -> Table:
        parts = [
            (to_base(log.vectors[topic].times_ns), log.vectors[topic])
            for log, to_base in zip(self.logs, self._maps, strict=True)
            if topic in log.vectors
        ]
        if not parts:
            raise KeyError(f"{self.path} has no topic {topic!r}; it has {', '.join(self.topics) or 'none'}")
        parts.sort(key=lambda part: int(part[0][0]))
        record_type = parts[-1][1].record_type
        same = [(times_ns, part) for times_ns, part in parts if part.record_type == record_type]
        return Table(
            topic,
            record_type.names,
            dict(record_type.fields),
            np.concatenate([times_ns for times_ns, _ in same]),
            np.concatenate([part.values for _, part in same]) if len(same) > 1 else same[0][1].values,
        )


def open_flight(path: Path | str) -> Flight:
    """Open a flight folder, or a single log file.

    Raises
    ------
    FlightError
        If it does not exist, contains no flight log, or one that is unreadable, foreign, newer or empty.
    """
    path = Path(path)
    if not path.exists():
        raise FlightError(f"{path}: no such flight")
    files = sorted(path.glob("*.mcap")) if path.is_dir() else [path]
    if not files:
        raise FlightError(f"{path}: contains no flight log (*.mcap)")
    logs = sorted((read_log_file(file) for file in files), key=_run_order)
    logs = [log for log in logs if log.process != MERGED] or logs  # a merged copy next to its sources adds nothing
    if not any(log.record_count for log in logs):
        raise FlightError(f"{path}: the flight log contains no records")
    return Flight(path, tuple(logs))


def _on_base(messages: list[tuple[int, PayloadT]], to_base: ClockMap) -> list[tuple[int, PayloadT]]:
    """Messages with their times mapped to the common time base."""
    times = to_base(np.array([time_ns for time_ns, _ in messages], dtype=np.int64))
    return [(int(time_ns), payload) for time_ns, (_, payload) in zip(times, messages, strict=True)]


def _run_order(log: LogFile) -> tuple[str, int, str]:
    """Sort key: the runs of a restarted process in order of time."""
    started = log.metadata.get("started_monotonic_ns", "0")
    return log.process, int(started) if started.isdigit() else 0, log.path.name


def _gaps(name: str, topic: VectorTopic, to_base: ClockMap) -> list[Gap]:
    if len(topic.times_ns) < 2:
        return []
    lost = np.diff(topic.sequences) - 1
    pauses = np.diff(topic.times_ns)
    silent = pauses > max(GAP_MIN_NS, GAP_PERIODS * float(np.median(pauses)))
    regular = len(pauses) >= REGULAR_RECORDS_MIN and np.quantile(pauses, 0.9) <= 2 * np.median(pauses)
    where = np.flatnonzero((lost > 0) | (silent & regular))
    times = to_base(topic.times_ns)
    return [Gap(name, int(times[i]), int(times[i + 1]), max(int(lost[i]), 0)) for i in where]
