"""The trace of a flight: onboard's tick records and the vehicle's truth at the same times."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flight_log.reader import Flight
from flight_log.schema import RecordType
from onboard.flight.supervisor import FlightMode
from onboard.record.tick import TICK
from protocol.conventions import Array
from sim_vehicle.records import TRUTH

Times = NDArray[np.int64]


class Columns:
    """The rows of one record type, by field name."""

    def __init__(self, record_type: RecordType, rows: Array) -> None:
        """Store rows, [n, fields]."""
        self._index = {name: index for index, name in enumerate(record_type.names)}
        self.rows = rows

    def __getitem__(self, name: str) -> Array:
        """Return one column, [n]. Raises KeyError for an unknown field."""
        column: Array = self.rows[:, self._index[name]]
        return column

    def vector(self, name: str, axes: str) -> Array:
        """Return the columns name_axis, [n, len(axes)]."""
        return np.stack([self[f"{name}_{axis}"] for axis in axes], axis=1)


@dataclass(frozen=True)
class FlightTrace:
    """Tick records and truth of a flight, at the same times."""

    time_s: Array
    """[n], from the first tick."""
    tick: Columns
    truth: Columns

    @property
    def mode(self) -> NDArray[np.int64]:
        """[n], FlightMode numbers."""
        return self.tick["mode"].astype(np.int64)

    @property
    def on_path(self) -> NDArray[np.bool_]:
        """[n], true while the vehicle follows the target: flying or holding, without take-off and landing."""
        return np.isin(self.mode, [FlightMode.FLYING.value, FlightMode.HOLD.value])

    @property
    def position_error(self) -> Array:
        """[n, 3], true position minus target, m."""
        return self.truth.vector("position", "ned") - self.tick.vector("target", "ned")

    @property
    def attitude_error(self) -> Array:
        """[n], angle between the true and the commanded attitude, rad."""
        dot = np.abs(
            (self.truth.vector("quaternion", "wxyz") * self.tick.vector("commanded_quaternion", "wxyz")).sum(1)
        )
        angle: Array = 2.0 * np.arccos(np.clip(dot, 0.0, 1.0))
        return angle

    @property
    def true_delta(self) -> Array:
        """[n, 6], true Delta, the ideal nu_ad: acceleration minus u_hat, position channel then attitude channel."""
        position = self.truth.vector("acceleration", "ned") - self.tick.vector("position_delivered", "ned")
        attitude = self.truth.vector("angular_acceleration", "xyz") - self.tick.vector("attitude_delivered", "xyz")
        return np.hstack([position, attitude])


def align(tick_ns: Times, ticks: Array, truth_ns: Times, truths: Array) -> FlightTrace:
    """Return a trace from two logs on one clock: each tick with the newest row of truth that is not later.

    Raises
    ------
    ValueError
        If either log is empty.
    """
    if tick_ns.size == 0 or truth_ns.size == 0:
        raise ValueError("a log has no ticks or no truth")
    newest = np.clip(np.searchsorted(truth_ns, tick_ns, side="right") - 1, 0, None)
    return FlightTrace((tick_ns - tick_ns[0]) * 1e-9, Columns(TICK, ticks), Columns(TRUTH, truths[newest]))


def trace_of(flight: Flight) -> FlightTrace | None:
    """Return the trace of a recorded flight; None if one of its logs is missing or empty."""
    tick, truth = flight.get(TICK.topic), flight.get(TRUTH.topic)
    if tick is None or truth is None or len(tick) == 0 or len(truth) == 0:
        return None
    return align(tick.time_ns, tick.values, truth.time_ns, truth.values)
