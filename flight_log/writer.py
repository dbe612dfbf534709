"""The flight log of one process: records go into rings, a thread lays them into an MCAP file.

Theory of operation. `write` costs the 200 Hz loop three array assignments into a preallocated ring. Every
FLUSH_PERIOD_S a thread copies what is new out of the rings, in whole arrays, and writes it as one MCAP chunk in one
unbuffered write. So a process killed at any moment loses at most what it logged since the last flush. Nothing that
goes wrong with the disk reaches the flight: logging stops, says so once, and `failure` holds the reason. A ring that
runs full drops the newest records, counts them, and records an event; their sequence numbers are missing in the
file, so a reader sees where. Without the thread (`threaded=False`, for the lockstep simulation, where a second of
flight takes milliseconds) the same flush is called from `write` by the records' own time, and nothing is dropped.
"""

import sys
import threading
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

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
from flight_log.metadata import describe_process
from flight_log.schema import RecordType

FLUSH_PERIOD_S: Final = 0.3
FLUSH_PERIOD_NS: Final = int(FLUSH_PERIOD_S * 1e9)
RING_ROWS: Final = 1024
"""5 s of a topic at 200 Hz: what a slow disk may take before records are dropped. A power of two."""
CLOSE_TIMEOUT_S: Final = 10.0
RUNS_MAX: Final = 1000
EVENT_DEFINITION: Final = "string text\n"
BYTES_DEFINITION: Final = "uint8[] data\n"


class _VectorRing:
    """Records of one topic on their way to the file: one thread pushes, one drains."""

    def __init__(self, channel: int, field_count: int) -> None:
        self.channel = channel
        self.dropped = 0
        self._times = np.zeros(RING_ROWS, dtype=np.int64)
        self._sequences = np.zeros(RING_ROWS, dtype=np.int64)
        self._values = np.zeros((RING_ROWS, field_count))
        self._sequence = 0
        self._head = 0
        self._tail = 0

    def push(self, time_ns: int, vector: NDArray[np.float64]) -> int:
        """Takes a record in; returns how many wait. A full ring counts and drops it."""
        sequence, head = self._sequence, self._head
        self._sequence = sequence + 1
        waiting = head - self._tail
        if waiting >= RING_ROWS:
            self.dropped += 1
            return waiting
        row = head & (RING_ROWS - 1)
        self._times[row] = time_ns
        self._sequences[row] = sequence
        self._values[row] = vector
        self._head = head + 1  # last: the draining thread looks at rows below it only
        return waiting + 1

    def drain(self) -> Block | None:
        """What waits, as a block."""
        tail, head = self._tail, self._head
        if tail == head:
            return None
        rows = np.arange(tail, head) & (RING_ROWS - 1)
        block = vector_block(self.channel, self._sequences[rows], np.maximum(self._times[rows], 0), self._values[rows])
        self._tail = head
        return block


class _BytesRing:
    """Messages of any length of one topic on their way to the file."""

    def __init__(self, channel: int) -> None:
        self.channel = channel
        self.dropped = 0
        self._messages: deque[tuple[int, int, bytes]] = deque()
        self._sequence = 0

    def push(self, time_ns: int, cdr: bytes) -> int:
        sequence, waiting = self._sequence, len(self._messages)
        self._sequence = sequence + 1
        if waiting >= RING_ROWS:
            self.dropped += 1
            return waiting
        self._messages.append((sequence, time_ns, cdr))
        return waiting + 1

    def drain(self) -> Block | None:
        messages = [self._messages.popleft() for _ in range(len(self._messages))]
        return bytes_block(self.channel, messages) if messages else None


class FlightLogWriter:
    """The flight log of one process. To be written to from one thread; never raises once it stands.

    Parameters
    ----------
    path: the file, such as `flights/.../onboard.mcap`. A restarted process does not overwrite its earlier log but
        writes `onboard_2.mcap` beside it; readers put the two together.
    process: "onboard", "offboard" or "sim_vehicle".
    metadata: anything to be said about the run, such as the seed; versions, start time and clock are added unless
        given. `clock` names the clock the times are in: logs with the same name share one time base.
    attachments: files kept within the log, by name: the resolved configuration.
    threaded: write in the background (real time) or within `write` (lockstep).
    on_failure: told once, in one line, when logging had to stop; prints to stderr unless given.

    Raises
    ------
    OSError
        From the constructor only, when the file cannot be created.
    """

    def __init__(
        self,
        path: Path,
        process: str,
        metadata: Mapping[str, str] | None = None,
        attachments: Mapping[str, bytes] | None = None,
        *,
        threaded: bool = True,
        on_failure: Callable[[str], None] | None = None,
    ) -> None:
        self.process = process
        self.failure = ""
        """Why logging stopped; "" while all is well."""
        self._on_failure = on_failure or _say
        self._vectors: dict[str, _VectorRing] = {}
        self._texts: dict[str, _BytesRing] = {}
        self._reported_drops: dict[str, int] = {}
        self._last_flush_ns = -(10**18)
        self._newest_ns = 0
        self._closed = False
        self.path, self._file = _create(path)
        self._own_events = _BytesRing(self._file.add_channel(f"{process}/log", EVENT_DEFINITION))
        self._try(lambda: self._begin(metadata or {}, attachments or {}))
        self._wake = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"{process} log", daemon=True) if threaded else None
        if self._thread is not None:
            self._thread.start()

    @property
    def dropped(self) -> int:
        """Records lost because a ring was full."""
        return sum(ring.dropped for ring in self._rings().values())

    def declare(self, record_type: RecordType) -> _VectorRing:
        """Makes room for a record type ahead of its first record, which is then as cheap as the others."""
        channel = self._file.add_channel(record_type.topic, ros_definition(record_type))
        ring = _VectorRing(channel, len(record_type.fields))
        self._vectors = {**self._vectors, record_type.topic: ring}  # replaced: the thread may be walking the old one
        return ring

    def write(self, record_type: RecordType, time_ns: int, vector: NDArray[np.float64]) -> None:
        """Logs one record; `vector` is copied.

        Raises
        ------
        ValueError
            If the vector's length is not that of the record type (our own mistake, never the disk's).
        """
        if self._closed:
            return
        ring = self._vectors.get(record_type.topic)
        if ring is None:
            ring = self.declare(record_type)
        self._pushed(ring.push(time_ns, vector), time_ns)

    def write_bytes(self, topic: str, time_ns: int, data: bytes) -> None:
        """Logs bytes as they are, such as a datagram, for replay."""
        if not self._closed:
            self._push_bytes(topic, BYTES_DEFINITION, time_ns, cdr_bytes(data))

    def event(self, time_ns: int, text: str) -> None:
        """Logs something that happened, in words."""
        if not self._closed:
            self._push_bytes(f"{self.process}/events", EVENT_DEFINITION, time_ns, cdr_string(text))

    def close(self) -> None:
        """Writes what waits and the summary, and closes the file. Never raises; may be called again."""
        if self._closed:
            return
        self._closed = True
        if self._thread is not None:
            self._wake.set()
            self._thread.join(CLOSE_TIMEOUT_S)
            if self._thread.is_alive():  # it still holds the file, which therefore stays open
                self._say_failure("the disk does not take the last records")
                return
        self._try(self._flush)
        self._try(self._file.finish)
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _begin(self, metadata: Mapping[str, str], attachments: Mapping[str, bytes]) -> None:
        own = {"format_version": str(FORMAT_VERSION), "process": self.process}
        self._file.start()
        self._file.add_metadata(METADATA_NAME, {**describe_process(), **metadata, **own})
        for name, data in attachments.items():
            self._file.add_attachment(name, data)

    def _push_bytes(self, topic: str, definition: str, time_ns: int, cdr: bytes) -> None:
        ring = self._texts.get(topic)
        if ring is None:
            ring = _BytesRing(self._file.add_channel(topic, definition))
            self._texts = {**self._texts, topic: ring}
        self._pushed(ring.push(max(time_ns, 0), cdr), time_ns)

    def _pushed(self, waiting: int, time_ns: int) -> None:
        self._newest_ns = time_ns
        if self._thread is None:
            if waiting >= RING_ROWS or time_ns - self._last_flush_ns >= FLUSH_PERIOD_NS:
                self._last_flush_ns = time_ns
                self._try(self._flush)
        elif waiting == RING_ROWS // 2:
            self._wake.set()

    def _run(self) -> None:
        while not self._closed and not self.failure:
            self._wake.wait(FLUSH_PERIOD_S)
            self._wake.clear()
            self._try(self._flush)

    def _rings(self) -> dict[str, _VectorRing | _BytesRing]:
        return {**self._vectors, **self._texts}

    def _flush(self) -> None:
        rings = self._rings()
        for topic, ring in rings.items():
            dropped = ring.dropped
            new = dropped - self._reported_drops.get(topic, 0)
            if new > 0:
                self._reported_drops[topic] = dropped
                text = f"flight log: {new} records of {topic} lost, the disk was too slow"
                self._own_events.push(max(self._newest_ns, 0), cdr_string(text))
        drained = [ring.drain() for ring in rings.values()]
        blocks = [block for block in (*drained, self._own_events.drain()) if block is not None]
        if blocks:
            self._file.write_chunk(blocks)

    def _try(self, action: Callable[[], None]) -> None:
        """Runs what may fail for the disk's reasons; the first failure ends the log."""
        if self.failure:
            return
        try:
            action()
        except OSError as error:
            self._fail(error.strerror or str(error))
        except Exception as error:  # a mistake of ours in the log must not cost the vehicle
            self._fail(f"{type(error).__name__}: {error}")

    def _fail(self, reason: str) -> None:
        self._closed = True
        self._file.close()
        self._say_failure(reason)

    def _say_failure(self, reason: str) -> None:
        self.failure = reason
        self._on_failure(f"{self.process}: the flight log stopped, the flight goes on: {self.path}: {reason}")


def _create(path: Path) -> tuple[Path, McapFile]:
    path.parent.mkdir(parents=True, exist_ok=True)
    for run in range(1, RUNS_MAX):
        candidate = path if run == 1 else path.with_stem(f"{path.stem}_{run}")
        try:
            return candidate, McapFile(candidate)
        except FileExistsError:
            continue
    raise FileExistsError(17, "too many logs of one process", str(path))


def _say(message: str) -> None:
    print(message, file=sys.stderr, flush=True)
