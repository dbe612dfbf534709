"""One log file read back, whole or torn: what stands in it up to the first damage."""

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
"""Start, end, uncompressed size, CRC, length of the compression's name; then an 8-byte length and the records."""


class FlightError(PlainError):
    """A flight that cannot be read: one line that says which file and why."""


@dataclass(slots=True)
class VectorTopic:
    """A topic's records as they stand in one file, in the writer's own clock."""

    record_type: RecordType
    sequences: NDArray[np.int64]
    """[n]: grows by one with every record that was handed to the log."""
    times_ns: NDArray[np.int64]
    """[n]"""
    values: NDArray[np.float64]
    """[n, fields]"""


@dataclass(slots=True)
class LogFile:
    """What one log file holds."""

    path: Path
    process: str = ""
    metadata: dict[str, str] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    vectors: dict[str, VectorTopic] = field(default_factory=dict)
    texts: dict[str, list[tuple[int, str]]] = field(default_factory=dict)
    """Topic -> (time in ns, text)."""
    raw: dict[str, list[tuple[int, bytes]]] = field(default_factory=dict)
    """Topic -> (time in ns, bytes)."""
    whole: bool = False
    """The file was closed; otherwise its process was killed, still runs, or the disk was full."""
    damage: str = ""
    """Where reading had to stop although the file goes on; "" when it did not."""

    @property
    def record_count(self) -> int:
        """Records of all kinds."""
        vectors = sum(len(topic.times_ns) for topic in self.vectors.values())
        texts = sum(len(messages) for messages in self.texts.values())
        return vectors + texts + sum(len(messages) for messages in self.raw.values())


def read_log_file(path: Path) -> LogFile:
    """Reads a log file as far as it can be read.

    Raises
    ------
    FlightError
        If the file cannot be opened, is no flight log, or was written by a newer version of this project.
    """
    return LogTail(path).read()


class LogTail:
    """Reads a log file, also while it grows: each `read` gives what has come since the one before."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._position = len(MAGIC)
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._metadata: dict[str, str] = {}
        self._process = path.stem
        self._ended = False

    def read(self) -> LogFile:
        """What is new: all of it at the first call. Raises FlightError."""
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
        """The last record of the data was there."""

    def parse(self, position: int) -> int:
        """Fills the log from a position up to the first damage; returns where it stopped.

        Raises FlightError for a file that is none of ours.
        """
        for start, opcode, body in self._records(position):
            position = start + RECORD_HEAD_BYTES + len(body)
            try:
                self._take(opcode, body)
            except (EndOfFile, KeyError, ValueError, struct.error) as error:
                self._log.damage = f"damaged record at byte {start} ({error})"
                break
            if opcode == Opcode.DATA_END:
                self.ended = True
                self._log.whole = bytes(self._data[-len(MAGIC) :]) == MAGIC
                break
        self._gather()
        return position

    def _records(self, position: int) -> Iterator[tuple[int, int, memoryview]]:
        """(position, opcode, body) of every whole record; ends at the first torn or impossible one."""
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

    def _take(self, opcode: int, body: memoryview) -> None:
        if opcode == Opcode.HEADER and Header.read(_stream(body)).library != LIBRARY:
            raise FlightError(f"{self._log.path}: an MCAP file, but no flight log of this project")
        if opcode == Opcode.METADATA:
            self._take_metadata(Metadata.read(_stream(body)))
        elif opcode == Opcode.ATTACHMENT:
            attachment = Attachment.read(_stream(body))
            self._log.attachments[attachment.name] = attachment.data
        elif opcode == Opcode.CHUNK:
            self._take_chunk(body)

    def _take_metadata(self, record: Metadata) -> None:
        if record.name != METADATA_NAME:
            return
        version = record.metadata.get("format_version", "")
        if not version.isdigit() or int(version) > FORMAT_VERSION:
            raise FlightError(
                f"{self._log.path}: written in format {version or 'unknown'}, this version reads up to {FORMAT_VERSION}"
            )
        self._log.metadata = dict(record.metadata)
        self._log.process = record.metadata.get("process", self._log.process)

    def _take_chunk(self, body: memoryview) -> None:
        *_, size, crc, name_length = CHUNK_HEAD.unpack_from(body)
        start = CHUNK_HEAD.size + name_length + 8
        if name_length or len(body) - start != size:
            raise ValueError("compressed chunk")
        records = body[start:]
        if zlib.crc32(records) != crc:
            raise ValueError("checksum of a chunk")
        position = 0
        while position + RECORD_HEAD_BYTES <= len(records):
            opcode = records[position]
            length = int.from_bytes(records[position + 1 : position + RECORD_HEAD_BYTES], "little")
            end = position + RECORD_HEAD_BYTES + length
            if opcode == Opcode.MESSAGE:
                end = self._take_messages(records, position)
            elif opcode == Opcode.SCHEMA:
                schema = Schema.read(_stream(records[position + RECORD_HEAD_BYTES : end]))
                self._schemas[schema.id] = schema
            elif opcode == Opcode.CHANNEL:
                channel = Channel.read(_stream(records[position + RECORD_HEAD_BYTES : end]))
                self._channels[channel.id] = channel
            position = end

    def _take_messages(self, records: memoryview, position: int) -> int:
        """Takes the run of messages of one channel that starts at `position`; returns where it ends."""
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
        dtype = message_dtype(len(payload) // 8)
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
                raise FlightError(f"{self._log.path}: {channel.topic}: fields and records do not fit each other")
            self._log.vectors[channel.topic] = VectorTopic(
                record_type,
                np.concatenate([part["sequence"] for part in parts]).astype(np.int64),
                np.concatenate([part["log_time"] for part in parts]).astype(np.int64),
                np.concatenate([part["values"] for part in parts]),
            )


def _stream(body: memoryview) -> ReadDataStream:
    return ReadDataStream(BytesIO(body))
