"""Numbers of one flight, each stated with its window. The position error is true position against target."""

from dataclasses import dataclass

import numpy as np

from experiments.flights.trace import FlightTrace
from onboard.flight.trajectory import Path, TrajectoryConfig
from protocol.conventions import Array

TARGET_DISTANCE_MAX_M = 2.5
"""Farther from the target than this the flight counts as lost (docs/experiments.md)."""


def rms(vectors: Array) -> float:
    """Root of the mean squared norm of [n, m] (or of [n]); NaN for none."""
    if vectors.shape[0] == 0:
        return float("nan")
    squared = vectors**2 if vectors.ndim == 1 else (vectors**2).sum(axis=1)
    return float(np.sqrt(squared.mean()))


@dataclass(frozen=True)
class FlightMetrics:
    """Tracking of one flight."""

    position_rmse_m: float
    """Over the whole flight after take-off and before landing."""
    attitude_rmse_rad: float
    """Angle to the commanded attitude, same window."""
    lap_rmse_m: tuple[float, ...]
    """Whole laps at full speed, in order; empty where the path has no laps."""

    @property
    def settled_rmse_m(self) -> float:
        """Over the second half of the laps; the whole flight where there are no laps."""
        laps = self.lap_rmse_m
        if not laps:
            return self.position_rmse_m
        half = laps[len(laps) // 2 :]
        return float(np.sqrt(np.mean(np.square(half))))


def flight_metrics(trace: FlightTrace, trajectory: TrajectoryConfig) -> FlightMetrics:
    """Metrics of a trace that flew a trajectory."""
    on_path = trace.on_path
    error = trace.position_error
    return FlightMetrics(
        rms(error[on_path]), rms(trace.attitude_error[on_path]), tuple(_lap_errors(trace, error, Path(trajectory)))
    )


def _lap_errors(trace: FlightTrace, error: Array, path: Path) -> list[float]:
    if path.lap_s == 0.0:
        return []
    lap = np.floor((trace.tick["path_time"] - path.laps_from_s()) / path.lap_s)
    usable = trace.on_path & (lap >= 0)
    if not usable.any():
        return []
    last = int(lap[usable].max())
    whole = trace.tick["path_time"].max() >= path.laps_from_s() + (last + 1) * path.lap_s - 0.02
    return [rms(error[usable & (lap == number)]) for number in range(last + int(whole))]


def lost_target(trace: FlightTrace) -> str:
    """Why the flight is lost by distance from the target, or ""."""
    distance = np.linalg.norm(trace.position_error, axis=1)
    far = trace.on_path & (distance > TARGET_DISTANCE_MAX_M)
    if not far.any():
        return ""
    return f"more than {TARGET_DISTANCE_MAX_M} m from the target at {trace.time_s[int(np.argmax(far))]:.1f} s"
