"""A flight as a PX4 ULog file, for the tools of that world (PlotJuggler, Flight Review, pyulog).

Layout: https://docs.px4.io/main/en/dev_log/ulog_file_format. Times are in whole us since the flight's start plus
one second, because a ULog time of 0 means "none". Every topic becomes a message such as `onboard_tick` of float32
fields, every event a logged string.
"""

import re
import struct
from pathlib import Path
from typing import Any, Final

import numpy as np

from flight_record.reader import Flight, Table

MAGIC: Final = b"ULog\x01\x12\x35\x01"
START_US: Final = 1_000_000
INFO_LEVEL: Final = ord("6")
TEXT_MAX_BYTES: Final = 1000
HEAD: Final = struct.Struct("<HB")
"""Message size without this head, and message type."""


def write_ulog(flight: Flight, path: Path) -> None:
    """Writes the whole flight. Raises OSError."""
    tables = list(flight)
    with path.open("wb") as file:
        file.write(MAGIC + struct.pack("<Q", START_US))
        file.write(_message("B", bytes(8 + 8 + 24)))
        for process, values in flight.metadata.items():
            for key, value in values.items():
                file.write(_info(f"{process}_{key}", value))
        for table in tables:
            fields = "".join(f"float {name};" for name in field_names(table))
            file.write(_message("F", f"{ulog_name(table.topic)}:uint64_t timestamp;{fields}".encode()))
        for number, table in enumerate(tables):
            file.write(_message("A", struct.pack("<BH", 0, number) + ulog_name(table.topic).encode()))
        for number, table in enumerate(tables):
            file.write(_rows(table, number, flight.start_ns).tobytes())
        for event in flight.events:
            text = f"{event.process}: {event.text}".encode()[:TEXT_MAX_BYTES]
            stamp = START_US + (event.time_ns - flight.start_ns) // 1000
            file.write(_message("L", struct.pack("<BQ", INFO_LEVEL, max(stamp, 0)) + text))


def ulog_name(topic: str) -> str:
    """A topic's name in letters that ULog allows: "onboard/tick" -> "onboard_tick"."""
    return re.sub(r"[^A-Za-z0-9]+", "_", topic)


def field_names(table: Table) -> list[str]:
    """The columns' names in letters that ULog allows."""
    return [re.sub(r"[^A-Za-z0-9_]", "_", name) for name in table.names]


def _rows(table: Table, number: int, start_ns: int) -> np.ndarray[Any, Any]:
    """All of a topic's data messages as one array, byte for byte."""
    dtype = np.dtype(
        [
            ("size", "<u2"),
            ("type", "u1"),
            ("number", "<u2"),
            ("timestamp", "<u8"),
            ("values", "<f4", (len(table.names),)),
        ]
    )
    rows = np.empty(len(table), dtype=dtype)
    rows["size"] = dtype.itemsize - HEAD.size
    rows["type"] = ord("D")
    rows["number"] = number
    rows["timestamp"] = START_US + (table.time_ns - start_ns) // 1000
    with np.errstate(over="ignore", invalid="ignore"):
        rows["values"] = table.values
    return rows


def _message(kind: str, body: bytes) -> bytes:
    return HEAD.pack(len(body), ord(kind)) + body


def _info(key: str, value: str) -> bytes:
    text = value.encode()[:TEXT_MAX_BYTES]
    name = f"char[{len(text)}] {re.sub(r'[^A-Za-z0-9_]', '_', key)}".encode()
    return _message("I", bytes([len(name)]) + name + text)
