"""The flight log of one process: records go into rings, and a thread writes them to an MCAP file.

Theory of operation. `write` costs the 200 Hz loop three array assignments into a preallocated ring. Every
FLUSH_PERIOD_S a thread copies the new records out of the rings, as arrays, and writes them as one MCAP chunk in one
unbuffered write. A process that is killed thus loses at most the records since the last flush. An error of the disk
does not affect the flight: logging stops, one message says where, and `failure` holds the reason. A full ring drops
new records, counts them, and logs an event; their sequence numbers are missing in the file, so a reader can locate the
gap. Without the thread (`threaded=False`, for the lockstep simulation, where a second of flight takes milliseconds)
`write` flushes by the time of the records, and no record is dropped.
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
"""5 s of a topic at 200 Hz: how long a disk may take before records are dropped. A power of two."""
CLOSE_TIMEOUT_S: Final = 10.0
RUNS_MAX: Final = 1000
EVENT_DEFINITION: Final = "string text\n"
BYTES_DEFINITION: Final = "uint8[] data\n"


class _VectorRing:
    """Records of one topic before they are written: one thread pushes, one drains."""

    def __init__(self, channel: int, record_type: RecordType) -> None:
        self.channel = channel
        self.dropped = 0
        self._kind = record_type.kind
        self._times = np.zeros(RING_ROWS, dtype=np.int64)
        self._sequences = np.zeros(RING_ROWS, dtype=np.int64)
        self._values = np.zeros((RING_ROWS, len(record_type.fields)))
        self._sequence = 0
        self._head = 0
        self._tail = 0

    def push(self, time_ns: int, vector: NDArray[np.float64]) -> int:
        """Store a record; returns the number of waiting records. A full ring counts and drops it."""
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
        self._head = head + 1  # last: the draining thread reads only the rows below it
        return waiting + 1

    def drain(self) -> Block | None:
        """The waiting records as a block; None if there are none."""
        tail, head = self._tail, self._head
        if tail == head:
            return None
        rows = np.arange(tail, head) & (RING_ROWS - 1)
        times_ns, values = np.maximum(self._times[rows], 0), self._values[rows]
        block = vector_block(self.channel, self._sequences[rows], times_ns, values, self._kind)
        self._tail = head
        return block


class _BytesRing:
    """Messages of one topic, of any length, before they are written."""

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
    """The flight log of one process. Only one thread may write to it. After construction no disk error raises.

    Parameters
    ----------
    path: the file, such as `flights/.../onboard.mcap`. If it exists, as after a restart, `onboard_2.mcap` is written
        next to it; readers combine the two.
    process: "onboard", "offboard" or "sim_vehicle".
    metadata: facts about the run, such as the seed; versions, start time and clock are added unless given. `clock` is
        the name of the clock of all times: logs with the same name share one time base.
    attachments: files to store in the log, by name: the resolved configuration.
    threaded: write in the background (real time) or within `write` (lockstep).
    on_failure: called once, with one line of text, when logging has stopped; by default it prints to stderr.

    Raises
    ------
    OSError
        From the constructor, if the file cannot be created.
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
        """The reason why logging stopped; "" while it works."""
        self._on_failure = on_failure or _print_failure
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
        """Records dropped because a ring was full."""
        return sum(ring.dropped for ring in self._rings().values())

    def declare(self, record_type: RecordType) -> _VectorRing:
        """Allocate the ring of a record type, so that its first record costs no more than the others."""
        channel = self._file.add_channel(record_type.topic, ros_definition(record_type))
        ring = _VectorRing(channel, record_type)
        # a new dict: the thread may be iterating over the old one
        self._vectors = {**self._vectors, record_type.topic: ring}
        return ring

    def write(self, record_type: RecordType, time_ns: int, vector: NDArray[np.float64]) -> None:
        """Log one record; `vector` is copied.

        Raises
        ------
        ValueError
            If the vector's length is not that of the record type.
        """
        if self._closed:
            return
        ring = self._vectors.get(record_type.topic)
        if ring is None:
            ring = self.declare(record_type)
        self._pushed(ring.push(time_ns, vector), time_ns)

    def write_bytes(self, topic: str, time_ns: int, data: bytes) -> None:
        """Log bytes, such as a datagram, for replay."""
        if not self._closed:
            self._push_bytes(topic, BYTES_DEFINITION, time_ns, cdr_bytes(data))

    def event(self, time_ns: int, text: str) -> None:
        """Log an event as text."""
        if not self._closed:
            self._push_bytes(f"{self.process}/events", EVENT_DEFINITION, time_ns, cdr_string(text))

    def close(self) -> None:
        """Write the waiting records and the summary, and close the file. Never raises; may be called again."""
        if self._closed:
            return
        self._closed = True
        if self._thread is not None:
            self._wake.set()
            self._thread.join(CLOSE_TIMEOUT_S)
            if self._thread.is_alive():  # the thread still uses the file, which therefore stays open
                self._report_failure("the last records cannot be written to the disk")
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
        """Run an action that the disk may make fail; the first failure stops the log."""
        if self.failure:
            return
        try:
            action()
        except OSError as error:
            self._fail(error.strerror or str(error))
        except Exception as error:  # an error in the log must not cost the vehicle
            self._fail(f"{type(error).__name__}: {error}")

    def _fail(self, reason: str) -> None:
        self._closed = True
        self._file.close()
        self._report_failure(reason)

    def _report_failure(self, reason: str) -> None:
        self.failure = reason
        place = f"after {self._file.duration_s:.1f} s"
        self._on_failure(f"the flight log stopped {place}, the flight goes on: {self.path}: {reason}")


def _create(path: Path) -> tuple[Path, McapFile]:
    path.parent.mkdir(parents=True, exist_ok=True)
    for run in range(1, RUNS_MAX):
        candidate = path if run == 1 else path.with_stem(f"{path.stem}_{run}")
        try:
            return candidate, McapFile(candidate)
        except FileExistsError:
            continue
    raise FileExistsError(17, "too many logs of one process", str(path))


def _print_failure(message: str) -> None:
    print(message, file=sys.stderr, flush=True)
