"""What a flight left behind, on one time base: onboard ticks and the vehicle's truth at the same instants."""

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
    """Rows of one record type, readable by field name."""

    def __init__(self, record_type: RecordType, rows: Array) -> None:
        """rows: [n, fields]."""
        self._index = {name: index for index, name in enumerate(record_type.names)}
        self.rows = rows

    def __getitem__(self, name: str) -> Array:
        """One column, [n]. Raises KeyError for an unknown field."""
        column: Array = self.rows[:, self._index[name]]
        return column

    def vector(self, name: str, axes: str) -> Array:
        """[n, len(axes)]: the columns name_axis."""
        return np.stack([self[f"{name}_{axis}"] for axis in axes], axis=1)


@dataclass(frozen=True)
class FlightTrace:
    """A flight's ticks and truth, row by row at the same times."""

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
        """[n], true while the target is followed: flying or holding, take-off and landing left out."""
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
        """[n, 6]: what nu_ad ought to be, true acceleration minus u_hat, position then attitude channel."""
        position = self.truth.vector("acceleration", "ned") - self.tick.vector("position_delivered", "ned")
        attitude = self.truth.vector("angular_acceleration", "xyz") - self.tick.vector("attitude_delivered", "xyz")
        return np.hstack([position, attitude])


def align(tick_ns: Times, ticks: Array, truth_ns: Times, truths: Array) -> FlightTrace:
    """A trace from two logs on one clock: of the truth, for each tick the newest row not after it.

    Raises
    ------
    ValueError
        If either log is empty.
    """
    if tick_ns.size == 0 or truth_ns.size == 0:
        raise ValueError("a log without ticks, or without truth")
    newest = np.clip(np.searchsorted(truth_ns, tick_ns, side="right") - 1, 0, None)
    return FlightTrace((tick_ns - tick_ns[0]) * 1e-9, Columns(TICK, ticks), Columns(TRUTH, truths[newest]))


def trace_of(flight: Flight) -> FlightTrace | None:
    """The trace of a recorded flight; None if a log of it is missing or empty."""
    tick, truth = flight.get(TICK.topic), flight.get(TRUTH.topic)
    if tick is None or truth is None or len(tick) == 0 or len(truth) == 0:
        return None
    return align(tick.time_ns, tick.values, truth.time_ns, truth.values)
