"""The metrics of one flight, with their windows. The position error is the true position minus the target."""

from dataclasses import dataclass
from math import ceil

import numpy as np

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


@dataclass(frozen=True)
class BoundMetrics:
    """The live bound of one channel against the true tracking error, m or rad; NaN without a bound."""

    bound_median: float
    error_median: float
    coverage: float
    """Share of the ticks with error <= bound."""


def bound_metrics(trace: FlightTrace) -> dict[str, BoundMetrics]:
    """Return the live bounds by channel, over the ticks on the path that have one: those in which the laws adapt."""
    errors = {"position": np.linalg.norm(trace.position_error, axis=1), "attitude": trace.attitude_error}
    metrics = {}
    for channel, error in errors.items():
        bound = trace.tick[f"{channel}_tracking_bound"]
        rows = trace.on_path & (bound > 0.0)
        coverage = float((error <= bound)[rows].mean()) if rows.any() else float("nan")
        metrics[channel] = BoundMetrics(median(bound[rows]), median(error[rows]), coverage)
    return metrics


def lost_target(trace: FlightTrace) -> str:
    """Return the reason if the vehicle was too far from the target; "" if it was not."""
    distance = np.linalg.norm(trace.position_error, axis=1)
    far = trace.on_path & (distance > TARGET_DISTANCE_MAX_M)
    if not far.any():
        return ""
    return f"more than {TARGET_DISTANCE_MAX_M} m from the target at {trace.time_s[int(np.argmax(far))]:.1f} s"
