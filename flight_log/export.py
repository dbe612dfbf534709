"""Exports a flight: as CSV, as a NumPy file, or with all its logs merged into one MCAP file."""

import heapq
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from mcap.writer import Writer

from flight_log.log_file import FlightError
from flight_log.mcap_file import (
    CDR_HEADER,
    FORMAT_VERSION,
    LIBRARY,
    METADATA_NAME,
    PRIVATE,
    PROFILE,
    cdr_bytes,
    cdr_string,
    media_type,
    ros_definition,
    ros_name,
)
from flight_log.reader import MERGED, Flight, Table
from flight_log.schema import RecordType
from flight_log.writer import BYTES_DEFINITION, EVENT_DEFINITION

SLICE_NS: Final = 500_000_000
"""Of a merged log: in a slice, the messages of a topic follow one another, so that they can be read as one array."""


def export_csv(flight: Flight, folder: Path) -> list[Path]:
    """Write one CSV file per topic, such as `onboard_tick.csv`, and `events.csv`; returns their paths.

    The first line has columns and units. Times are in s since the flight's t = 0. Raises OSError.
    """
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for table in flight:
        path = folder / f"{file_stem(table.topic)}.csv"
        _write_csv(table, flight.start_ns, path)
        written.append(path)
    events = folder / "events.csv"
    with events.open("w", encoding="utf-8", newline="") as file:
        file.write("time [s],process,event\n")
        for event in flight.events:
            text = event.text.replace('"', '""')
            file.write(f'{(event.time_ns - flight.start_ns) * 1e-9:.6f},{event.process},"{text}"\n')
    return [*written, events]


def file_stem(topic: str) -> str:
    """The name of a topic's file without its ending: "onboard/tick" -> "onboard_tick"."""
    return re.sub(r"[^A-Za-z0-9]+", "_", topic)


def _write_csv(table: Table, start_ns: int, path: Path) -> None:
    heads = [f"{name} [{unit}]" if unit else name for name, unit in table.units.items()]
    heads = [f'"{head}"' if "," in head else head for head in heads]
    rows = np.column_stack([table.seconds(start_ns), table.values])
    line = ",".join(["%.6f"] + ["%.9g"] * len(heads))
    np.savetxt(path, rows, line, header=",".join(["time [s]", *heads]), comments="", encoding="utf-8")


def export_npz(flight: Flight, path: Path) -> None:
    """Write one NumPy file with `onboard/tick.time_ns`, `onboard/tick.position_n` and so on, [n] each.

    `onboard/tick.units` has the units, `start_ns` the time of the flight's t = 0.

    Raises OSError.
    """
    arrays: dict[str, Any] = {"start_ns": np.int64(flight.start_ns)}
    for table in flight:
        arrays[f"{table.topic}.time_ns"] = table.time_ns
        arrays[f"{table.topic}.units"] = np.array([table.units[name] for name in table.names])
        arrays.update({f"{table.topic}.{name}": column for name, column in table.columns.items()})
    arrays["events.time_ns"] = np.array([event.time_ns for event in flight.events], dtype=np.int64)
    arrays["events.text"] = np.array([f"{event.process}: {event.text}" for event in flight.events], dtype=np.str_)
    np.savez(path, **arrays)


def merge(flight: Flight, path: Path) -> None:
    """Write one MCAP file with all logs on the common time base; configurations are attached as `<process>/<name>`.

    Raises
    ------
    FlightError
        If the file exists already.
    OSError
        If it cannot be written.
    """
    try:
        stream = path.open("xb")
    except FileExistsError:
        raise FlightError(f"{path}: exists already") from None
    with stream:
        path.chmod(PRIVATE)
        file = Writer(stream)
        file.start(profile=PROFILE, library=LIBRARY)
        file.add_metadata(METADATA_NAME, _merged_metadata(flight.metadata))
        for process, attachments in flight.attachments.items():
            for name, data in attachments.items():
                file.add_attachment(0, 0, f"{process}/{name}", media_type(name), data)
        topics = [*_vectors(flight), *_messages(flight)]
        streams = [_numbered(_channel(file, topic, definition), found) for topic, definition, found in topics]
        for time_ns, channel, sequence, cdr in heapq.merge(*streams, key=lambda one: (one[0] // SLICE_NS, one[1])):
            file.add_message(channel, time_ns, CDR_HEADER + cdr, time_ns, sequence)
        file.finish()


def _merged_metadata(metadata: Mapping[str, Mapping[str, str]]) -> dict[str, str]:
    parts = {f"{process}.{key}": value for process, values in metadata.items() for key, value in values.items()}
    return {**parts, "format_version": str(FORMAT_VERSION), "process": MERGED, "clock": MERGED}


def _channel(file: Writer, topic: str, definition: str) -> int:
    schema = file.register_schema(ros_name(topic), "ros2msg", definition.encode())
    return int(file.register_channel(topic, "cdr", schema))


def _numbered(channel: int, found: Iterable[tuple[int, bytes]]) -> Iterator[tuple[int, int, int, bytes]]:
    """Time, channel, sequence number and CDR bytes of each message."""
    return ((max(time_ns, 0), channel, sequence, cdr) for sequence, (time_ns, cdr) in enumerate(found))


def _vectors(flight: Flight) -> Iterator[tuple[str, str, Iterable[tuple[int, bytes]]]]:
    """(topic, definition, (time, CDR bytes)) of the tables."""
    for table in flight:
        rows = (row.tobytes() for row in table.values.astype("<f8"))
        definition = ros_definition(RecordType(table.topic, tuple(table.units.items())))
        yield table.topic, definition, zip(table.time_ns.tolist(), rows, strict=True)


def _messages(flight: Flight) -> list[tuple[str, str, list[tuple[int, bytes]]]]:
    """(topic, definition, (time, CDR bytes) in order of time) of events and byte topics."""
    found = []
    for process in flight.processes:
        texts = [(event.time_ns, cdr_string(event.text)) for event in flight.events if event.process == process]
        found.append((f"{process}/events", EVENT_DEFINITION, texts))
    for topic in flight.byte_topics:
        raw = sorted(flight.messages(topic), key=lambda message: message[0])
        found.append((topic, BYTES_DEFINITION, [(time_ns, cdr_bytes(data)) for time_ns, data in raw]))
    return [entry for entry in found if entry[2]]
