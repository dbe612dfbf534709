"""Reads one log file, complete or cut off: all its records up to the first damage."""

import mmap
import os
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any, Final

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Metadata, Schema
from numpy.typing import NDArray

from flight_log.chunk_columns import restored
from flight_log.mcap_file import (
    CDR_HEADER,
    FORMAT_VERSION,
    LIBRARY,
    MAGIC,
    MESSAGE_HEAD,
    METADATA_NAME,
    RECORD_HEAD_BYTES,
    message_dtype,
    record_type_of,
)
from flight_log.schema import RecordType
from runtime.errors import PlainError

CHUNK_HEAD: Final = struct.Struct("<QQQII")
"""Start, end, uncompressed size, CRC, length of the compression name; then an 8-byte length and the records."""


class FlightError(PlainError):
    """A flight that cannot be read; the message, one line, names the file and the reason."""


@dataclass(slots=True)
class VectorTopic:
    """The records of a topic in one file, in the writer's clock."""

    record_type: RecordType
    sequences: NDArray[np.int64]
    """[n]: increases by one with every record given to the log."""
    times_ns: NDArray[np.int64]
    """[n]"""
    values: NDArray[np.float64]
    """[n, fields]"""


@dataclass(slots=True)
class LogFile:
    """The content of one log file."""

    path: Path
    process: str = ""
    metadata: dict[str, str] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    vectors: dict[str, VectorTopic] = field(default_factory=dict)
    texts: dict[str, list[tuple[int, str]]] = field(default_factory=dict)
    """Topic -> (time in ns, text)."""
    raw: dict[str, list[tuple[int, bytes]]] = field(default_factory=dict)
    """Topic -> (time in ns, bytes)."""
    complete: bool = False
    """The file was closed; otherwise its process was killed, still runs, or the disk was full."""
    damage: str = ""
    """Where and why reading stopped before the end of the file; "" if it did not."""

    @property
    def record_count(self) -> int:
        """Records of all kinds."""
        vectors = sum(len(topic.times_ns) for topic in self.vectors.values())
        texts = sum(len(messages) for messages in self.texts.values())
        return vectors + texts + sum(len(messages) for messages in self.raw.values())


def read_log_file(path: Path) -> LogFile:
    """Read a log file, as far as it is readable.

    Raises
    ------
    FlightError
        If the file cannot be opened, is not a flight log, or was written by a newer version of this project.
    """
    return LogTail(path).read()


class LogTail:
    """Reads a log file that may still grow: each `read` returns what was added since the one before."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._position = len(MAGIC)
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._metadata: dict[str, str] = {}
        self._process = path.stem
        self._ended = False

    def read(self) -> LogFile:
        """The new records; at the first call, all. Raises FlightError."""
        log = LogFile(path=self.path, process=self._process, metadata=self._metadata)
        if self._ended:
            return log
        data = self._map()
        if not MAGIC.startswith(bytes(data[: len(MAGIC)])):
            raise FlightError(f"{self.path}: not an MCAP file")
        parser = _Parser(log, data, self._schemas, self._channels)
        self._position = parser.parse(self._position)
        self._ended = parser.ended
        self._process, self._metadata = log.process, log.metadata
        return log

    def _map(self) -> memoryview:
        try:
            with self.path.open("rb") as file:
                size = os.fstat(file.fileno()).st_size
                return memoryview(mmap.mmap(file.fileno(), size, access=mmap.ACCESS_READ) if size else b"")
        except OSError as error:
            raise FlightError(f"{self.path}: cannot be read: {error.strerror}") from None


class _Parser:
    def __init__(
        self, log: LogFile, data: memoryview, schemas: dict[int, Schema], channels: dict[int, Channel]
    ) -> None:
        self._log = log
        self._data = data
        self._schemas = schemas
        self._channels = channels
        self._vectors: dict[int, list[NDArray[Any]]] = {}
        self.ended = False
        """The record that ends the data was read."""

    def parse(self, position: int) -> int:
        """Read the records from a position up to the first damage; returns the position reached.

        Raises FlightError for a file that this project did not write.
        """
        for start, opcode, body in self._records(position):
            position = start + RECORD_HEAD_BYTES + len(body)
            try:
                self._read_record(opcode, body)
            except (EndOfFile, KeyError, ValueError, struct.error) as error:
                self._log.damage = f"damaged record at byte {start} ({error})"
                break
            if opcode == Opcode.DATA_END:
                self.ended = True
                self._log.complete = bytes(self._data[-len(MAGIC) :]) == MAGIC
                break
        self._gather()
        return position

    def _records(self, position: int) -> Iterator[tuple[int, int, memoryview]]:
        """(position, opcode, body) of every complete record, up to the first incomplete or invalid one."""
        data = self._data
        while position + RECORD_HEAD_BYTES <= len(data):
            opcode = data[position]
            length = int.from_bytes(data[position + 1 : position + RECORD_HEAD_BYTES], "little")
            start = position + RECORD_HEAD_BYTES
            if not Opcode.HEADER <= opcode <= Opcode.DATA_END:
                self._log.damage = f"no MCAP record at byte {position}"
                return
            if start + length > len(data):
                return
            yield position, opcode, data[start : start + length]
            position = start + length

    def _read_record(self, opcode: int, body: memoryview) -> None:
        if opcode == Opcode.HEADER and Header.read(_stream(body)).library != LIBRARY:
            raise FlightError(f"{self._log.path}: an MCAP file, but not a flight log of this project")
        if opcode == Opcode.METADATA:
            self._read_metadata(Metadata.read(_stream(body)))
        elif opcode == Opcode.ATTACHMENT:
            attachment = Attachment.read(_stream(body))
            self._log.attachments[attachment.name] = attachment.data
        elif opcode == Opcode.CHUNK:
            self._read_chunk(body)

    def _read_metadata(self, record: Metadata) -> None:
        if record.name != METADATA_NAME:
            return
        version = record.metadata.get("format_version", "")
        if not version.isdigit() or int(version) > FORMAT_VERSION:
            raise FlightError(
                f"{self._log.path}: written in format {version or 'unknown'}, this version reads up to {FORMAT_VERSION}"
            )
        self._log.metadata = dict(record.metadata)
        self._log.process = record.metadata.get("process", self._log.process)

    def _read_chunk(self, body: memoryview) -> None:
        *_, size, crc, name_length = CHUNK_HEAD.unpack_from(body)
        start = CHUNK_HEAD.size + name_length
        compression = bytes(body[CHUNK_HEAD.size : start]).decode()
        records = memoryview(restored(compression, body[start + 8 :], size))
        if zlib.crc32(records) != crc:
            raise ValueError("checksum of a chunk")
        position = 0
        while position + RECORD_HEAD_BYTES <= len(records):
            opcode = records[position]
            length = int.from_bytes(records[position + 1 : position + RECORD_HEAD_BYTES], "little")
            end = position + RECORD_HEAD_BYTES + length
            if opcode == Opcode.MESSAGE:
                end = self._read_messages(records, position)
            elif opcode == Opcode.SCHEMA:
                schema = Schema.read(_stream(records[position + RECORD_HEAD_BYTES : end]))
                self._schemas[schema.id] = schema
            elif opcode == Opcode.CHANNEL:
                channel = Channel.read(_stream(records[position + RECORD_HEAD_BYTES : end]))
                self._channels[channel.id] = channel
            position = end

    def _read_messages(self, records: memoryview, position: int) -> int:
        """Read the successive messages of one channel that start at `position`; returns where they end."""
        _, length, number, _, time_ns, _ = MESSAGE_HEAD.unpack_from(records, position)
        channel = self._channels[number]
        definition = self._schemas[channel.schema_id].data.decode()
        end: int = position + RECORD_HEAD_BYTES + length
        payload = bytes(records[position + MESSAGE_HEAD.size + len(CDR_HEADER) : end])
        if definition.startswith("string "):
            text = payload[4:-1].decode(errors="replace")
            self._log.texts.setdefault(channel.topic, []).append((time_ns, text))
            return end
        if definition.startswith("uint8[] "):
            self._log.raw.setdefault(channel.topic, []).append((time_ns, payload[4:]))
            return end
        kind = "float32" if definition.startswith("float32 ") else "float64"
        dtype = message_dtype(len(payload) // np.dtype(kind).itemsize, kind)
        rows = np.frombuffer(records, dtype, (len(records) - position) // dtype.itemsize, position)
        same = (rows["channel"] == number) & (rows["length"] == length) & (rows["opcode"] == Opcode.MESSAGE)
        count = len(rows) if same.all() else int(np.argmin(same))
        self._vectors.setdefault(number, []).append(rows[:count])
        return position + count * dtype.itemsize

    def _gather(self) -> None:
        for number, parts in self._vectors.items():
            channel = self._channels[number]
            record_type = record_type_of(channel.topic, self._schemas[channel.schema_id].data.decode())
            width = parts[0]["values"].shape[1]
            if record_type is None or len(record_type.fields) != width:
                raise FlightError(f"{self._log.path}: {channel.topic}: the fields do not match the records")
            self._log.vectors[channel.topic] = VectorTopic(
                record_type,
                np.concatenate([part["sequence"] for part in parts]).astype(np.int64),
                np.concatenate([part["log_time"] for part in parts]).astype(np.int64),
                np.concatenate([part["values"] for part in parts]).astype(np.float64),
            )


def _stream(body: memoryview) -> ReadDataStream:
    return ReadDataStream(BytesIO(body))
