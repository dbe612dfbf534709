"""The metrics of one flight, with their windows. The position error is the true position minus the target."""

from dataclasses import dataclass
from math import ceil

import numpy as np
from numpy.typing import NDArray

from experiments.flights.trace import FlightTrace
from onboard.flight.trajectory import Path, TrajectoryConfig
from protocol.conventions import Array

TARGET_DISTANCE_MAX_M = 2.5
"""A flight at a larger distance from the target counts as lost (docs/experiments.md)."""

FIRST_WITHOUT_LAPS_S = 12.0
"""On a path without laps this window stands for the first lap."""


def rms(vectors: Array) -> float:
    """Return the root of the mean squared norm of [n, m] (or of [n]); NaN for none."""
    if vectors.shape[0] == 0:
        return float("nan")
    squared = vectors**2 if vectors.ndim == 1 else (vectors**2).sum(axis=1)
    return float(np.sqrt(squared.mean()))


def _root_mean_square(values: tuple[float, ...]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


@dataclass(frozen=True)
class FlightMetrics:
    """Tracking of one flight."""

    position_rmse_m: float
    """From the end of take-off to the beginning of landing."""
    attitude_rmse_rad: float
    """Angle between true and commanded attitude, same window."""
    lap_rmse_m: tuple[float, ...]
    """Of each complete lap at full speed, on a lissajous path of each window as long; empty if there are none."""
    first_windows: int = 1
    """Entries of lap_rmse_m that count as the first lap: more on a lissajous path, together FIRST_WITHOUT_LAPS_S."""

    @property
    def first_lap_rmse_m(self) -> float:
        """Over the first lap, or over the first FIRST_WITHOUT_LAPS_S of a lissajous path; NaN if not complete."""
        first = self.lap_rmse_m[: self.first_windows]
        return _root_mean_square(first) if len(first) == self.first_windows else float("nan")

    @property
    def settled_rmse_m(self) -> float:
        """Over the second half of the laps; over the whole flight if there are no laps."""
        laps = self.lap_rmse_m
        if not laps:
            return self.position_rmse_m
        return _root_mean_square(laps[len(laps) // 2 :])


def flight_metrics(trace: FlightTrace, trajectory: TrajectoryConfig) -> FlightMetrics:
    """Return the metrics of a trace on this trajectory."""
    on_path = trace.on_path
    error, path = trace.position_error, Path(trajectory)
    first = 1 if path.window_s == path.lap_s else ceil(FIRST_WITHOUT_LAPS_S / path.window_s)
    laps = tuple(_lap_errors(trace, error, path))
    return FlightMetrics(rms(error[on_path]), rms(trace.attitude_error[on_path]), laps, first)


def _lap_errors(trace: FlightTrace, error: Array, path: Path) -> list[float]:
    window_s = path.window_s
    if window_s == 0.0:
        return []
    lap = np.floor((trace.tick["path_time"] - path.laps_from_s()) / window_s)
    usable = trace.on_path & (lap >= 0)
    if not usable.any():
        return []
    last = int(lap[usable].max())
    whole = trace.tick["path_time"].max() >= path.laps_from_s() + (last + 1) * window_s - 0.02
    return [rms(error[usable & (lap == number)]) for number in range(last + int(whole))]


def median(values: Array) -> float:
    """Return the median; NaN for none."""
    return float(np.median(values)) if values.size else float("nan")


def known_ages(trace: FlightTrace, name: str) -> Array:
    """Return a column of ages on the path, s, without the negative ones, which mean "never"."""
    ages = trace.tick[name][trace.on_path]
    known: Array = ages[ages >= 0.0]
    return known


def bound_medians(trace: FlightTrace, rows: NDArray[np.bool_]) -> dict[str, tuple[float, float]]:
    """Return the medians of the live bound on norm(e) and of norm(e) over these rows, by channel."""
    medians = {}
    for channel, first, second in (("position", "ned", "ned"), ("attitude", "xyz", "pqr")):
        parts = [trace.tick.vector(f"{channel}_error", first), trace.tick.vector(f"{channel}_error_rate", second)]
        bound = trace.tick[f"{channel}_live_bound"][rows]
        medians[channel] = median(bound[bound > 0.0]), median(np.linalg.norm(np.hstack(parts)[rows], axis=1))
    return medians


def lost_target(trace: FlightTrace) -> str:
    """Return the reason if the vehicle was too far from the target; "" if it was not."""
    distance = np.linalg.norm(trace.position_error, axis=1)
    far = trace.on_path & (distance > TARGET_DISTANCE_MAX_M)
    if not far.any():
        return ""
    return f"more than {TARGET_DISTANCE_MAX_M} m from the target at {trace.time_s[int(np.argmax(far))]:.1f} s"
