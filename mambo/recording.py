"""Reads what the library has recorded on the drone, `dmrac.rec`."""

import struct
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from configs.loader import ConfigError
from mambo.config import BoardConfig
from onboard.record.tick import TICK
from protocol.conventions import Array

MAGIC: Final = b"DMRR"
VERSION: Final = 1
HEADER: Final = struct.Struct("<BBHq")
SAMPLE, WHOLE, FLOW, EVENT, TICKS, MOTORS = range(1, 7)
"""Kinds of record (mambo/library/recorder.h)."""
SAMPLE_TYPE: Final = np.dtype(
    [
        ("accelerometer", "<f4", 3),
        ("gyroscope", "<f4", 3),
        ("fifo_accelerometer", "<f4", (5, 3)),
        ("fifo_gyroscope", "<f4", (5, 3)),
        ("pressure", "<f4"),
        ("altitude", "<f4"),
        ("battery_v", "<f4"),
        ("battery_percent", "<u4"),
    ]
)
FLOW_TYPE: Final = np.dtype([("velocity", "<f4", 3), ("defined", "<i4"), ("quality", "<f4")])
MOTORS_TYPE: Final = np.dtype([("word", "<i4"), ("speeds", "<i2", 4)])


class Rows(NamedTuple):
    """Records of one kind."""

    time_s: Array
    """[n], from the first record."""
    values: NDArray[Any]
    """[n], a structured array, or [n, fields]."""


class Recording(NamedTuple):
    """A file."""

    samples: Rows
    flows: Rows
    motors: Rows
    ticks: Rows
    """Per onboard.record.tick.TICK, about 20 Hz."""
    whole: list[bytes]
    """Whole acquisition structures."""
    events: list[tuple[float, str]]
    start_ns: int
    """The drone's clock at the first record."""


def read_recording(path: Path) -> Recording:
    """A recording. Raises ConfigError that names the file and what is wrong with it."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None
    if data[:4] != MAGIC:
        raise ConfigError(f"{path}: not a recording of the library: it does not begin with {MAGIC.decode()}")
    if int.from_bytes(data[4:8], "little") != VERSION:
        raise ConfigError(f"{path}: recording of version {int.from_bytes(data[4:8], 'little')}, expected {VERSION}")
    found: dict[int, list[tuple[int, bytes]]] = {kind: [] for kind in range(1, 7)}
    at, start_ns = 8, None
    while at + HEADER.size <= len(data):
        kind, _, size, time_ns = HEADER.unpack_from(data, at)
        content = data[at + HEADER.size : at + HEADER.size + size]
        at += HEADER.size + size
        if len(content) < size:  # the drone was switched off while it wrote
            break
        if kind not in found:
            raise ConfigError(f"{path}: record of kind {kind} at byte {at}, expected 1 to 6: the file is damaged")
        start_ns = time_ns if start_ns is None else start_ns
        found[kind].append((time_ns, content))
    start = start_ns or 0
    events = [((when - start) * 1e-9, text.decode(errors="replace")) for when, text in found[EVENT]]
    return Recording(
        _rows(found[SAMPLE], SAMPLE_TYPE, start),
        _rows(found[FLOW], FLOW_TYPE, start),
        _rows(found[MOTORS], MOTORS_TYPE, start),
        _rows(found[TICKS], np.dtype(("<f4", len(TICK.fields))), start),
        [content for _, content in found[WHOLE]],
        events,
        start,
    )


def _rows(records: list[tuple[int, bytes]], kind: np.dtype[Any], start_ns: int) -> Rows:
    good = [(when, content) for when, content in records if len(content) == kind.itemsize]
    time_s: Array = np.array([(when - start_ns) * 1e-9 for when, _ in good])
    return Rows(time_s, np.frombuffer(b"".join(content for _, content in good), dtype=kind))


class Body(NamedTuple):
    """A recording in body axes and SI units, as the library reads it with these settings."""

    time_s: Array
    force: Array
    """[n, 3] m/s^2."""
    rates: Array
    """[n, 3] rad/s."""
    pressure_pa: Array
    altitude_m: Array
    battery_v: Array
    battery_percent: Array
    flow_s: Array
    velocity: Array
    """[m, 2] m/s, along body x and y."""


def in_body_axes(recording: Recording, board: BoardConfig) -> Body:
    """The readings that the library makes of a recording: the same axes, signs and units."""
    sensors, values = board.sensors, recording.samples.values
    several = sensors.imu == "fifo"
    force = values["fifo_accelerometer"].mean(axis=1) if several else values["accelerometer"]
    rates = values["fifo_gyroscope"].mean(axis=1) if several else values["gyroscope"]
    return Body(
        recording.samples.time_s,
        sensors.accelerometer_scale * _turned(force, sensors.accelerometer_axes),
        sensors.gyroscope_scale * _turned(rates, sensors.gyroscope_axes),
        sensors.pressure_scale * values["pressure"].astype(np.float64),
        sensors.altitude_scale * values["altitude"].astype(np.float64),
        values["battery_v"].astype(np.float64),
        values["battery_percent"].astype(np.float64),
        recording.flows.time_s,
        sensors.flow_scale * _turned(recording.flows.values["velocity"], sensors.flow_axes),
    )


def _turned(raw: NDArray[Any], axes: tuple[int, ...]) -> Array:
    """[n, k]: for each body axis the firmware's, with its sign."""
    columns = [np.sign(axis) * raw[:, abs(axis) - 1].astype(np.float64) for axis in axes]
    return np.stack(columns, axis=1)
