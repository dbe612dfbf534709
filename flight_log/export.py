"""Exports a flight: as CSV, as a NumPy file, or with all its logs merged into one MCAP file."""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from flight_log.log_file import FlightError
from flight_log.mcap_file import (
    FORMAT_VERSION,
    METADATA_NAME,
    Block,
    McapFile,
    bytes_block,
    cdr_bytes,
    cdr_string,
    ros_definition,
    vector_block,
)
from flight_log.reader import MERGED, Flight, Table
from flight_log.schema import RecordType
from flight_log.writer import BYTES_DEFINITION, EVENT_DEFINITION

MERGED_CHUNK_NS: Final = 500_000_000
CSV_ROWS_AT_ONCE: Final = 10_000


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
    line = ",".join(["%.6f"] + ["%.9g"] * len(heads)) + "\n"
    rows = np.column_stack([table.seconds(start_ns), table.values])
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write(",".join(["time [s]", *heads]) + "\n")
        for first in range(0, len(rows), CSV_ROWS_AT_ONCE):
            part = rows[first : first + CSV_ROWS_AT_ONCE]
            file.write((line * len(part)) % tuple(part.ravel().tolist()))


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
        file = McapFile(path, for_all=True)
    except FileExistsError:
        raise FlightError(f"{path}: exists already") from None
    try:
        file.start()
        file.add_metadata(METADATA_NAME, _merged_metadata(flight.metadata))
        for process, attachments in flight.attachments.items():
            for name, data in attachments.items():
                file.add_attachment(f"{process}/{name}", data)
        for blocks in _time_slices(flight, file):
            file.write_chunk(blocks)
        file.finish()
    finally:
        file.close()


def _merged_metadata(metadata: Mapping[str, Mapping[str, str]]) -> dict[str, str]:
    parts = {f"{process}.{key}": value for process, values in metadata.items() for key, value in values.items()}
    return {**parts, "format_version": str(FORMAT_VERSION), "process": MERGED, "clock": MERGED}


def _time_slices(flight: Flight, file: McapFile) -> Iterator[list[Block]]:
    """The blocks of the flight, chunk by chunk, in order of time."""
    tables = [
        (file.add_channel(t.topic, ros_definition(RecordType(t.topic, tuple(t.units.items())))), t) for t in flight
    ]
    messages = [(file.add_channel(topic, definition), found) for topic, definition, found in _messages(flight)]
    done_rows, done_messages = [0] * len(tables), [0] * len(messages)
    edge = min([flight.first_ns, *(found[0][0] for _, found in messages)])
    while edge <= max([flight.end_ns, *(found[-1][0] for _, found in messages)]):
        edge += MERGED_CHUNK_NS
        blocks = []
        for i, (channel, table) in enumerate(tables):
            rows = slice(done_rows[i], int(np.searchsorted(table.time_ns, edge)))
            if rows.start < rows.stop:
                sequences = np.arange(rows.start, rows.stop)
                blocks.append(vector_block(channel, sequences, table.time_ns[rows], table.values[rows]))
                done_rows[i] = rows.stop
        for i, (channel, found) in enumerate(messages):
            first = last = done_messages[i]
            while last < len(found) and found[last][0] < edge:
                last += 1
            if first < last:
                blocks.append(bytes_block(channel, [(n, max(found[n][0], 0), found[n][1]) for n in range(first, last)]))
                done_messages[i] = last
        if blocks:
            yield blocks


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
