"""Writes the training of a flight as a TensorBoard run, also while it is flown: losses, gate and buffer."""

import math
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from tensorboard.compat.proto.event_pb2 import Event
from tensorboard.compat.proto.summary_pb2 import Summary
from tensorboard.summary.writer.event_file_writer import EventFileWriter

from flight_log.log_file import FlightError, LogTail
from flight_log.reader import TICK_TOPIC, Flight

TRAINING_TOPIC: Final = "offboard/training"
EPOCH_TOPIC: Final = "offboard/epoch"
NOT_SHOWN: Final = ("round", "epoch")
GROUPS: Final = ("training_loss", "validation_loss", "test_loss", "flying_loss", "label_power", "lipschitz")
POLL_PERIOD_S: Final = 1.0


class TrainingRun:
    """A TensorBoard run that rounds and epochs are added to.

    The step of a round is its number, that of an epoch counts all epochs. The wall time of an entry is the flight's, s
    since t = 0.
    """

    def __init__(self, folder: Path) -> None:
        """Begin a run in `folder`. Raises OSError if it cannot be written."""
        folder.mkdir(parents=True, exist_ok=True)
        self._writer = EventFileWriter(str(folder))
        self._epochs = 0
        self.entries = 0
        """Rounds and epochs so far."""

    def add(self, flight: Flight, start_ns: int) -> None:
        """Add what a flight, or a part of it, has logged. start_ns: time of t = 0."""
        for topic in (TRAINING_TOPIC, EPOCH_TOPIC):
            table = flight.get(topic)
            if table is None:
                continue
            for row, time_s in enumerate(table.seconds(start_ns).tolist()):
                step = int(table["round"][row]) if topic == TRAINING_TOPIC else self._epochs + row
                values = zip(table.names, table.values[row].tolist(), strict=True)
                shown = [
                    Summary.Value(tag=tag(topic, name), simple_value=value)
                    for name, value in values
                    if name not in NOT_SHOWN and math.isfinite(value)
                ]
                self._writer.add_event(Event(wall_time=time_s, step=step, summary=Summary(value=shown)))
            self.entries += len(table)
            self._epochs += len(table) if topic == EPOCH_TOPIC else 0
        self._writer.flush()

    def close(self) -> None:
        """Write everything."""
        self._writer.close()


class _Follower:
    """Adds to a run what the growing logs of a flight have got since the call before."""

    def __init__(self, folder: Path, run: Path) -> None:
        self._folder, self._run_folder = folder, run
        self._tails: dict[str, LogTail] = {}
        self._start_ns: int | None = None
        self.run: TrainingRun | None = None
        """None: nothing was trained yet."""

    def read(self) -> None:
        """Read on. Training comes after onboard's first tick, which is t = 0; its log is read no further."""
        if self._start_ns is None:
            found = self._new("onboard")
            if found is None or TICK_TOPIC not in found:
                return
            self._start_ns = found.start_ns
        trained = self._new("offboard")
        if trained is None or not any(topic in trained for topic in (TRAINING_TOPIC, EPOCH_TOPIC)):
            return
        self.run = self.run or TrainingRun(self._run_folder)
        self.run.add(trained, self._start_ns)

    def _new(self, process: str) -> Flight | None:
        path = self._folder / f"{process}.mcap"
        if not path.exists():
            return None
        log = self._tails.setdefault(process, LogTail(path)).read()
        return Flight(self._folder, (log,)) if log.record_count else None


@contextmanager
def live_tensorboard(folder: Path, run: Path) -> Iterator[_Follower]:
    """Write the run while the flight into `folder` goes on, and the rest of it at the end of the block."""
    follower, done = _Follower(folder, run), threading.Event()

    def follow() -> None:
        while not done.wait(POLL_PERIOD_S):
            follower.read()

    thread = threading.Thread(target=follow, name="tensorboard", daemon=True)
    thread.start()
    try:
        yield follower
    finally:
        done.set()
        thread.join()
        follower.read()
        if follower.run is not None:
            follower.run.close()


def write_tensorboard(flight: Flight, folder: Path) -> None:
    """Write a run into `folder`.

    Raises
    ------
    FlightError
        If the flight logged no training.
    OSError
        If the run cannot be written.
    """
    if all(len(flight.get(topic) or ()) == 0 for topic in (TRAINING_TOPIC, EPOCH_TOPIC)):
        raise FlightError(f"{flight.path}: holds no {TRAINING_TOPIC}: nothing was trained in this flight")
    run = TrainingRun(folder)
    try:
        run.add(flight, flight.start_ns)
    finally:
        run.close()


def tag(topic: str, name: str) -> str:
    """The name under which a column is shown; its first part is the group."""
    group = next((group for group in GROUPS if name.startswith(group)), "gate")
    rest = name.removeprefix(group).strip("_") or name
    return f"{group}/{rest}" if topic == TRAINING_TOPIC else f"epoch {group}/{rest}"
