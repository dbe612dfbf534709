"""Writes a flight as a PX4 ULog file, for PlotJuggler, Flight Review and pyulog.

Format: https://docs.px4.io/main/en/dev_log/ulog_file_format. Times are unsigned, in whole us, and 0 means "none".
The flight's t = 0 is therefore at `time_zero_us`, whole seconds, late enough for the records before it. Every topic
becomes a message such as `onboard_tick` with float32 fields, every event a logged string.
"""

import re
import struct
from pathlib import Path
from typing import Any, Final

import numpy as np

from flight_log.reader import Flight, Table

MAGIC: Final = b"ULog\x01\x12\x35\x01"
SECOND_US: Final = 1_000_000
INFO_LEVEL: Final = ord("6")
TEXT_MAX_BYTES: Final = 1000
HEAD: Final = struct.Struct("<HB")
"""Message size without this header, and message type."""


def write_ulog(flight: Flight, path: Path) -> None:
    """Write the complete flight. Raises OSError."""
    tables = list(flight)
    zero_us = time_zero_us(flight)
    with path.open("wb") as file:
        file.write(MAGIC + struct.pack("<Q", SECOND_US))
        file.write(_message("B", bytes(8 + 8 + 24)))
        for process, values in flight.metadata.items():
            for key, value in values.items():
                file.write(_info(f"{process}_{key}", value))
        file.write(_info("time_zero_us", str(zero_us)))
        for table in tables:
            fields = "".join(f"float {name};" for name in field_names(table))
            file.write(_message("F", f"{ulog_name(table.topic)}:uint64_t timestamp;{fields}".encode()))
        for number, table in enumerate(tables):
            file.write(_message("A", struct.pack("<BH", 0, number) + ulog_name(table.topic).encode()))
        for number, table in enumerate(tables):
            file.write(_rows(table, number, zero_us - flight.start_ns // 1000).tobytes())
        for event in flight.events:
            text = f"{event.process}: {event.text}".encode()[:TEXT_MAX_BYTES]
            stamp = zero_us + event.time_ns // 1000 - flight.start_ns // 1000
            file.write(_message("L", struct.pack("<BQ", INFO_LEVEL, stamp) + text))


def time_zero_us(flight: Flight) -> int:
    """The ULog time of the flight's t = 0."""
    seconds_before = -((flight.first_ns - flight.start_ns) // 1_000_000_000)
    return SECOND_US * (1 + seconds_before)


def ulog_name(topic: str) -> str:
    """A topic's name in the characters that ULog allows: "onboard/tick" -> "onboard_tick"."""
    return re.sub(r"[^A-Za-z0-9]+", "_", topic)


def field_names(table: Table) -> list[str]:
    """Column names in the characters that ULog allows."""
    return [re.sub(r"[^A-Za-z0-9_]", "_", name) for name in table.names]


def _rows(table: Table, number: int, shift_us: int) -> np.ndarray[Any, Any]:
    """The bytes of all data messages of a topic, as one array."""
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
    rows["timestamp"] = table.time_ns // 1000 + shift_us
    with np.errstate(over="ignore", invalid="ignore"):
        rows["values"] = table.values
    return rows


def _message(kind: str, body: bytes) -> bytes:
    return HEAD.pack(len(body), ord(kind)) + body


def _info(key: str, value: str) -> bytes:
    text = value.encode()[:TEXT_MAX_BYTES]
    name = f"char[{len(text)}] {re.sub(r'[^A-Za-z0-9_]', '_', key)}".encode()
    return _message("I", bytes([len(name)]) + name + text)
