"""Writes an MCAP file chunk by chunk, in blocks of messages of equal length.

Theory of operation. A record of a flight is a time and a flat vector. All messages of a topic thus have the same
length, and a block of them is one structured numpy array whose memory is the MCAP bytes (`message_dtype`). A chunk is
the concatenation of a few blocks. This takes no Python code per message, which matters because the writer thread
shares the interpreter with the 200 Hz loop. Every chunk is written in one unbuffered write and contains the schemas it
needs, so the file stays readable if the process ends at any time. Records other than messages are built by the mcap
library. Format: https://mcap.dev/spec
"""

import os
import re
import struct
import zlib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from numpy.typing import NDArray

from flight_log.chunk_columns import COLUMNS, compressed_columns
from flight_log.schema import RecordType

MAGIC: Final = b"\x89MCAP0\r\n"
PRIVATE: Final = 0o600
"""Only the owner reads a log: it has what was on the wires."""
PROFILE: Final = "ros2"
LIBRARY: Final = "async-dmrac flight record"
FORMAT_VERSION: Final = 2
"""1: no chunk is compressed, all fields are float64. Both are read."""
METADATA_NAME: Final = "async_dmrac"
"""Name of the metadata record with the process that wrote the file and the format version."""
CDR_HEADER: Final = b"\x00\x01\x00\x00"
"""Little-endian CDR without options. Alignment counts from its end: fields of one kind need no padding."""
RECORD_HEAD_BYTES: Final = 9
"""Opcode (1) and length (8) at the start of every MCAP record."""
MESSAGE_HEAD: Final = struct.Struct("<BQHIQQ")
"""Opcode, length, channel, sequence, log time, publish time."""
MESSAGE_HEAD_BYTES: Final = MESSAGE_HEAD.size - RECORD_HEAD_BYTES

Rows = NDArray[Any]
"""Messages of one channel as a structured array of `message_dtype`."""


@dataclass(frozen=True, slots=True)
class Block:
    """Messages of one channel as bytes of a chunk; at least one."""

    channel: int
    data: bytes
    """Complete MESSAGE records, concatenated."""
    times: NDArray[np.uint64]
    """[n]: log time of each, ns."""
    rows: int = 1
    """Number of records of equal length that `data` consists of; 1 if their lengths differ."""


def message_dtype(field_count: int, kind: str = "float64") -> np.dtype[np.void]:
    """The bytes of an MCAP message record with a flat vector of float64 or float32, as a numpy type."""
    layout = [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
        ("cdr", "V4"),
        ("values", np.dtype(kind).newbyteorder("<"), (field_count,)),
    ]
    return np.dtype(layout)


def vector_block(
    channel: int,
    sequences: NDArray[np.int64],
    times_ns: NDArray[np.int64],
    values: NDArray[np.float64],
    kind: str = "float64",
) -> Block:
    """A block of flat vectors [n, k] with their sequence numbers [n] and times [n]; `kind` is that of RecordType."""
    dtype = message_dtype(values.shape[1], kind)
    rows: Rows = np.empty(len(values), dtype=dtype)
    rows["opcode"] = Opcode.MESSAGE
    rows["length"] = dtype.itemsize - RECORD_HEAD_BYTES
    rows["channel"] = channel
    rows["sequence"] = sequences
    rows["log_time"] = rows["publish_time"] = times_ns
    rows["cdr"] = np.void(CDR_HEADER)
    with np.errstate(over="ignore"):  # too large for float32: infinite in the log
        rows["values"] = values
    return Block(channel, rows.tobytes(), rows["log_time"].copy(), len(rows))


def bytes_block(channel: int, messages: Sequence[tuple[int, int, bytes]]) -> Block:
    """A block of messages of any length, each (sequence, time in ns, CDR bytes without the header)."""
    parts = []
    for sequence, time_ns, cdr in messages:
        length = MESSAGE_HEAD_BYTES + len(CDR_HEADER) + len(cdr)
        parts += [MESSAGE_HEAD.pack(Opcode.MESSAGE, length, channel, sequence, time_ns, time_ns), CDR_HEADER, cdr]
    times = np.array([time_ns for _, time_ns, _ in messages], dtype=np.uint64)
    return Block(channel, b"".join(parts), times)


def cdr_bytes(data: bytes) -> bytes:
    """A sequence of uint8 in CDR, without the header."""
    return len(data).to_bytes(4, "little") + data


def cdr_string(text: str) -> bytes:
    """A string in CDR, without the header."""
    return cdr_bytes(text.encode(errors="replace") + b"\x00")


def media_type(name: str) -> str:
    """The media type of an attachment, by its name."""
    return "application/yaml" if name.endswith((".yaml", ".yml")) else "application/octet-stream"


def ros_name(topic: str) -> str:
    """The schema name of a topic: "onboard/tick" -> "async_dmrac/msg/OnboardTick"."""
    return "async_dmrac/msg/" + "".join(word.capitalize() for word in re.split(r"[^A-Za-z0-9]+", topic) if word)


def ros_definition(record_type: RecordType) -> str:
    """The ros2msg text of a record type, with the unit of each field as a comment."""
    return "".join(f"{record_type.kind} {name}{f' # {unit}' if unit else ''}\n" for name, unit in record_type.fields)


def record_type_of(topic: str, definition: str) -> RecordType | None:
    """Inverse of `ros_definition`; None if the text contains anything but fields of one such kind."""
    fields, kinds = [], set[str]()
    for line in definition.splitlines():
        declaration, _, unit = line.partition("#")
        kind, _, name = declaration.strip().partition(" ")
        kinds.add(kind)
        if not name:
            return None
        fields.append((name.strip(), unit.strip()))
    if kinds == {"float32"}:
        return RecordType(topic, tuple(fields), "float32")
    return RecordType(topic, tuple(fields)) if kinds == {"float64"} else None


class McapFile:
    """An MCAP file open for writing, for this project's readers alone (flight_log.chunk_columns). Not thread-safe.

    Raises
    ------
    OSError
        From the constructor if the file cannot be created (it must not exist yet), and from every method that writes;
        the file is then truncated to its last complete record, and stays readable.
    """

    def __init__(self, path: Path) -> None:
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_CLOEXEC", 0), PRIVATE)
        self._position = 0
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._unwritten: list[Schema | Channel] = []
        self._chunks = bytearray()
        """The CHUNK_INDEX records, as bytes: a flight of hours has many."""
        self._chunk_count = 0
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._message_counts: dict[int, int] = {}
        self._times: tuple[int, int] | None = None

    def start(self) -> None:
        """Write the header of the file."""
        self._write(MAGIC + _records([Header(profile=PROFILE, library=LIBRARY)]))

    def add_channel(self, topic: str, definition: str) -> int:
        """Add a topic with its ros2msg text; returns its channel number. It is written with the next chunk."""
        number = len(self._channels) + 1
        schema = Schema(id=number, name=ros_name(topic), encoding="ros2msg", data=definition.encode())
        channel = Channel(id=number, topic=topic, message_encoding="cdr", metadata={}, schema_id=number)
        self._schemas[number], self._channels[number] = schema, channel
        self._unwritten += [schema, channel]
        return number

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record."""
        data = _records([Metadata(name=name, metadata=dict(values))])
        self._metadata.append(MetadataIndex(offset=self._position, length=len(data), name=name))
        self._write(data)

    def add_attachment(self, name: str, data: bytes) -> None:
        """Write an attachment."""
        kind = media_type(name)
        record = _records([Attachment(create_time=0, log_time=0, name=name, media_type=kind, data=data)])
        index = AttachmentIndex(
            offset=self._position,
            length=len(record),
            log_time=0,
            create_time=0,
            data_size=len(data),
            name=name,
            media_type=kind,
        )
        self._attachments.append(index)
        self._write(record)

    def write_chunk(self, blocks: Sequence[Block]) -> None:
        """Write the blocks as one chunk."""
        announced = tuple(self._unwritten)  # the other thread may append while this one writes
        head = _records(announced)
        body = b"".join([head, *(block.data for block in blocks)])
        first = min(int(block.times.min()) for block in blocks)
        last = max(int(block.times.max()) for block in blocks)
        tables = ((1, head), *((block.rows, block.data) for block in blocks))
        data = compressed_columns([one for one in tables if one[1]])
        chunk = _chunk_head(body, first, last, COLUMNS, len(data)) + data
        index = ChunkIndex(
            message_start_time=first,
            message_end_time=last,
            chunk_start_offset=self._position,
            chunk_length=len(chunk),
            message_index_offsets={},
            message_index_length=0,
            compression=COLUMNS,
            compressed_size=len(data),
            uncompressed_size=len(body),
        )
        self._write(chunk)
        del self._unwritten[: len(announced)]
        self._chunks += _records([index])
        self._chunk_count += 1
        self._count(blocks, first, last)

    def finish(self) -> None:
        """Write the summary, which completes the file. Call `close` afterwards."""
        self._write(_records([DataEnd(data_section_crc=0)]))
        self._write(self._summary(self._position))

    @property
    def duration_s(self) -> float:
        """From the first to the last record written, s."""
        first, last = self._times or (0, 0)
        return (last - first) * 1e-9

    def close(self) -> None:
        """Close the file, complete or not. Never raises."""
        if self._descriptor >= 0:
            with suppress(OSError):  # a deferred write error of the file system cannot be handled any more
                os.close(self._descriptor)
            self._descriptor = -1

    def _count(self, blocks: Sequence[Block], first: int, last: int) -> None:
        for block in blocks:
            self._message_counts[block.channel] = self._message_counts.get(block.channel, 0) + len(block.times)
        start, end = self._times or (first, last)
        self._times = min(start, first), max(end, last)

    def _summary(self, position: int) -> bytes:
        """The bytes of the summary section, which starts at `position`, with footer and final magic."""
        start, end = self._times or (0, 0)
        statistics = Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=self._message_counts,
            chunk_count=self._chunk_count,
            message_count=sum(self._message_counts.values()),
            message_start_time=start,
            message_end_time=end,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )
        groups: list[tuple[Opcode, bytes]] = [
            (Opcode.SCHEMA, _records(list(self._schemas.values()))),
            (Opcode.CHANNEL, _records(list(self._channels.values()))),
            (Opcode.STATISTICS, _records([statistics])),
            (Opcode.CHUNK_INDEX, bytes(self._chunks)),
            (Opcode.ATTACHMENT_INDEX, _records(self._attachments)),
            (Opcode.METADATA_INDEX, _records(self._metadata)),
        ]
        body, offsets = b"", list[SummaryOffset]()
        for opcode, records in groups:
            if records:
                offsets.append(SummaryOffset(opcode, position + len(body), len(records)))
            body += records
        offset_start = position + len(body)
        body += _records(offsets)
        plain = _records([Footer(summary_start=position, summary_offset_start=offset_start, summary_crc=0)])
        crc = zlib.crc32(plain[:-4], zlib.crc32(body))
        return body + plain[:-4] + crc.to_bytes(4, "little") + MAGIC

    def _write(self, data: bytes) -> None:
        view = memoryview(data)
        try:
            while view:
                view = view[os.write(self._descriptor, view) :]
        except OSError:
            self._cut_back()
            raise
        self._position += len(data)

    def _cut_back(self) -> None:
        with suppress(OSError):  # then the incomplete record stays, and readers stop before it
            os.ftruncate(self._descriptor, self._position)


def _records(records: Sequence[McapRecord]) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())


def _chunk_head(body: bytes, first: int, last: int, compression: str, size: int) -> bytes:
    """The bytes of a CHUNK record before its `size` bytes of compressed records."""
    fields = first.to_bytes(8, "little") + last.to_bytes(8, "little") + len(body).to_bytes(8, "little")
    fields += zlib.crc32(body).to_bytes(4, "little") + len(compression).to_bytes(4, "little") + compression.encode()
    fields += size.to_bytes(8, "little")
    return bytes([Opcode.CHUNK]) + (len(fields) + size).to_bytes(8, "little") + fields
