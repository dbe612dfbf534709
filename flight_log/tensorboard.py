"""Writes the training of a flight as a TensorBoard run: losses, gate and buffer of each round."""

import math
from pathlib import Path
from typing import Final

from tensorboard.compat.proto.event_pb2 import Event
from tensorboard.compat.proto.summary_pb2 import Summary
from tensorboard.summary.writer.event_file_writer import EventFileWriter

from flight_log.log_file import FlightError
from flight_log.reader import Flight

TRAINING_TOPIC: Final = "offboard/training"
EPOCH_TOPIC: Final = "offboard/epoch"
NOT_SHOWN: Final = ("round", "epoch")
GROUPS: Final = ("training_loss", "validation_loss", "test_loss", "flying_loss", "label_power", "lipschitz")


def write_tensorboard(flight: Flight, folder: Path) -> None:
    """Write a run into `folder`. The step of a round is its number, that of an epoch counts all epochs.

    The wall time of an entry is the flight's, s since t = 0.

    Raises
    ------
    FlightError
        If the flight logged no training.
    OSError
        If the run cannot be written.
    """
    topics = [(topic, flight.get(topic)) for topic in (TRAINING_TOPIC, EPOCH_TOPIC)]
    if all(table is None or len(table) == 0 for _, table in topics):
        raise FlightError(f"{flight.path}: holds no {TRAINING_TOPIC}: nothing was trained in this flight")
    folder.mkdir(parents=True, exist_ok=True)
    writer = EventFileWriter(str(folder))
    try:
        for topic, table in topics:
            if table is None:
                continue
            for row, time_s in enumerate(table.seconds(flight.start_ns).tolist()):
                step = int(table["round"][row]) if topic == TRAINING_TOPIC else row
                values = zip(table.names, table.values[row].tolist(), strict=True)
                shown = [
                    Summary.Value(tag=tag(topic, name), simple_value=value)
                    for name, value in values
                    if name not in NOT_SHOWN and math.isfinite(value)
                ]
                writer.add_event(Event(wall_time=time_s, step=step, summary=Summary(value=shown)))
    finally:
        writer.close()


def tag(topic: str, name: str) -> str:
    """The name under which a column is shown; its first part is the group."""
    group = next((group for group in GROUPS if name.startswith(group)), "gate")
    rest = name.removeprefix(group).strip("_") or name
    return f"{group}/{rest}" if topic == TRAINING_TOPIC else f"epoch {group}/{rest}"
