"""Writes a recording of the drone as a flight log, `mambo.mcap`, that `dmrac log` reads."""

from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from flight_log.schema import RecordType, vector_fields
from flight_log.writer import FlightLogWriter
from mambo.recording import Recording
from onboard.record.tick import TICK
from protocol.conventions import Array

PROCESS: Final = "mambo"
SAMPLE: Final = RecordType(
    "mambo/sample",
    (
        *vector_fields("accelerometer", "123", "firmware's axes and unit, mean of the FIFO"),
        *vector_fields("gyroscope", "123", "firmware's axes and unit, mean of the FIFO"),
        *vector_fields("accelerometer_single", "123", "the same, the single sample"),
        *vector_fields("gyroscope_single", "123", "the same, the single sample"),
        ("pressure", "firmware's unit"),
        ("altitude", "firmware's unit"),
        ("battery", "V"),
        ("battery_percent", "%"),
    ),
)
FLOW: Final = RecordType("mambo/flow", (*vector_fields("velocity", "123", "m/s"), ("defined", ""), ("quality", "")))
MOTORS: Final = RecordType("mambo/motors", (("word", "1 START, 2 STOP, 3 RUN"), *vector_fields("speed", "1234", "")))


def write_flight_log(recording: Recording, folder: Path) -> Path:
    """Write the log into a folder; returns the file."""
    path = folder / f"{PROCESS}.mcap"
    log = FlightLogWriter(path, PROCESS, {"source": "drone"}, threaded=False)
    try:
        for kind, times, rows in _tables(recording):
            for time_ns, row in zip(times, rows, strict=True):
                log.write(kind, int(time_ns), row)
        for time_s, text in recording.events:
            log.event(recording.start_ns + round(time_s * 1e9), text)
    finally:
        log.close()
    return path


def _tables(recording: Recording) -> list[tuple[RecordType, NDArray[np.int64], Array]]:
    """Each record type with its times, ns, and its rows."""
    samples, flows, motors, ticks = recording.samples, recording.flows, recording.motors, recording.ticks
    values = samples.values
    inertial = [values["fifo_accelerometer"].mean(axis=1), values["fifo_gyroscope"].mean(axis=1)]
    singles = [values["accelerometer"], values["gyroscope"]]
    slow = [values[name][:, None] for name in ("pressure", "altitude", "battery_v", "battery_percent")]
    flow = [flows.values["velocity"], flows.values["defined"][:, None], flows.values["quality"][:, None]]
    drive = [motors.values["word"][:, None], motors.values["speeds"]]
    tables = (
        (SAMPLE, samples.time_s, [*inertial, *singles, *slow]),
        (FLOW, flows.time_s, flow),
        (MOTORS, motors.time_s, drive),
        (TICK, ticks.time_s, [np.asarray(ticks.values).reshape(-1, len(TICK.fields))]),
    )
    return [
        (kind, recording.start_ns + np.rint(time_s * 1e9).astype(np.int64), np.hstack(columns).astype(np.float64))
        for kind, time_s, columns in tables
        if len(time_s)
    ]
