"""The row of one flight: metrics, link, features, and the command that repeats it."""

import json
import math
from collections.abc import Iterable
from typing import Any

import numpy as np
import pyarrow as pa

from experiments.flights.lockstep_flight import LockstepOutcome
from experiments.flights.metrics import bound_metrics, flight_metrics, known_ages, median, rms
from experiments.flights.scenario import FlightConfig
from experiments.flights.trace import FlightTrace
from onboard.flight.supervisor import FlightMode
from protocol.conventions import Array
from sim_vehicle.lockstep import TickResult

AFTER_ONSET_S = 4.0
"""Length of the first window after a fault."""
SETTLED_AFTER_ONSET_S = 10.0
"""Time after a fault from which the flight counts as settled."""
RECOVERED_RAD = math.radians(5.0)
RECOVERED_FOR_S = 1.0

_FLOATS = (
    *("duration_s", "flown_s", "onset_s", "position_rmse_m", "attitude_rmse_rad", "first_lap_rmse_m"),
    *("settled_rmse_m", "before_onset_rmse_m", "after_onset_rmse_m", "settled_after_onset_rmse_m"),
    *("worst_error_m", "recovery_s", "feature_age_median_s", "feature_age_max_s", "pose_age_median_s"),
    *("up_bytes_s", "down_bytes_s", "up_lost_share", "down_lost_share"),
    *("position_bound_median_m", "position_error_median_m", "position_bound_coverage"),
    *("attitude_bound_median_rad", "attitude_error_median_rad", "attitude_bound_coverage"),
    *("position_swap_jump_max_m_s2", "attitude_swap_jump_max_rad_s2", "wall_s", "cpu_s", "worker_peak_mib"),
)
_INTEGERS = ("seed", "feature_version", "swaps", "refused", "training_rounds", "versions_sent", "samples")
_TEXTS = ("key", "campaign", "case", "controller", "point", "crash_reason", "trace_sha256", "error", "command")

SCHEMA = pa.schema(
    [
        *((name, pa.string()) for name in _TEXTS),
        *((name, pa.int64()) for name in _INTEGERS),
        ("survived", pa.bool_()),
        *((name, pa.float64()) for name in _FLOATS),
        ("lap_rmse_m", pa.list_(pa.float64())),
    ]
)
"""Columns of flights.parquet. Times in s of flight time; docs/experiments.md defines the windows of the RMSE."""

Row = dict[str, Any]


class LinkBytes:
    """Observer of a flight that counts the bytes on the link."""

    def __init__(self) -> None:
        self.up = 0
        self.down = 0

    def __call__(self, result: TickResult) -> None:
        """Count the datagrams of one tick."""
        self.up += sum(len(datagram) for datagram in result.onboard.to_offboard)
        if result.offboard is not None:
            self.down += sum(len(datagram) for datagram in result.offboard.to_onboard)


def flight_row(config: FlightConfig, outcome: LockstepOutcome, link: LinkBytes) -> Row:
    """Return the measured part of a row; NaN for quantities that the flight does not have."""
    trace = outcome.trace
    metrics = flight_metrics(trace, config.onboard.guidance.trajectory)
    crash = outcome.crash_reason or _cut(trace)
    flown_s = float(trace.time_s[-1]) if trace.time_s.size else 0.0
    offboard = outcome.offboard or {}
    row: Row = {
        "seed": config.seed,
        "duration_s": config.duration_s,
        "flown_s": flown_s,
        "survived": not crash and bool(trace.on_path.any()),
        "crash_reason": crash,
        "error": "" if trace.on_path.any() or crash else "the vehicle never took off",
        "position_rmse_m": metrics.position_rmse_m,
        "attitude_rmse_rad": metrics.attitude_rmse_rad,
        "lap_rmse_m": list(metrics.lap_rmse_m),
        "first_lap_rmse_m": metrics.first_lap_rmse_m,
        "settled_rmse_m": metrics.settled_rmse_m,
        "worst_error_m": _worst(trace),
        "trace_sha256": outcome.trace_sha256,
        "training_rounds": int(offboard.get("rounds", 0)),
        "versions_sent": int(offboard.get("version", 0)),
        "samples": int(offboard.get("samples", 0)),
        "feature_version": int(outcome.onboard["features"]["version"]),
        "swaps": int(outcome.onboard["features"]["swaps"]),
        "refused": int(outcome.onboard["features"]["refused"]),
        "up_bytes_s": link.up / max(flown_s, 1e-9),
        "down_bytes_s": link.down / max(flown_s, 1e-9),
    }
    for direction, counts in outcome.radio.items():
        row[f"{direction}_lost_share"] = counts["lost"] / counts["sent"] if counts["sent"] else math.nan
    return row | _ages(trace) | _bounds(trace) | _swap_jumps(trace) | _fault_windows(config, trace)


def fault_onset_s(config: FlightConfig) -> float:
    """Return the onset of the first disturbance that is not present from the start; NaN if there is none."""
    onsets = [item.onset_s for item in config.vehicle.disturbances if item.onset_s > 0.0]
    return min(onsets, default=math.nan)


def _cut(trace: FlightTrace) -> str:
    last = trace.mode[-1] if trace.mode.size else FlightMode.BOOT
    if last in (FlightMode.EMERGENCY, FlightMode.TERMINATED):
        return "motors cut by the supervisor"
    climbed = bool((trace.mode == FlightMode.TAKE_OFF).any())
    return "never reached the height of its path" if climbed and not trace.on_path.any() else ""


def _worst(trace: FlightTrace) -> float:
    error = np.linalg.norm(trace.position_error[trace.on_path], axis=1)
    return float(error.max()) if error.size else math.nan


def _ages(trace: FlightTrace) -> Row:
    features = known_ages(trace, "feature_age")
    return {
        "feature_age_median_s": median(features),
        "feature_age_max_s": float(features.max()) if features.size else math.nan,
        "pose_age_median_s": median(known_ages(trace, "pose_age")),
    }


def _bounds(trace: FlightTrace) -> Row:
    row: Row = {}
    for (channel, one), unit in zip(bound_metrics(trace).items(), ("m", "rad"), strict=True):
        row |= {
            f"{channel}_bound_median_{unit}": one.bound_median,
            f"{channel}_error_median_{unit}": one.error_median,
            f"{channel}_bound_coverage": one.coverage,
        }
    return row


def _swap_jumps(trace: FlightTrace) -> Row:
    """Return the largest change of nu_ad over a tick with a swap in flight, per channel."""
    swapped = np.flatnonzero((np.diff(trace.tick["feature_version"]) != 0) & trace.on_path[1:])
    row: Row = {}
    for channel, axes, unit in (("position", "ned", "m_s2"), ("attitude", "xyz", "rad_s2")):
        nu = trace.tick.vector(f"{channel}_adaptive_now", axes)
        jumps = np.linalg.norm(nu[swapped + 1] - nu[swapped], axis=1)
        row[f"{channel}_swap_jump_max_{unit}"] = float(jumps.max()) if jumps.size else math.nan
    return row


def _fault_windows(config: FlightConfig, trace: FlightTrace) -> Row:
    onset = fault_onset_s(config)
    row: Row = {"onset_s": onset}
    names = ("before_onset_rmse_m", "after_onset_rmse_m", "settled_after_onset_rmse_m", "recovery_s")
    if math.isnan(onset):
        return row | dict.fromkeys(names, math.nan)
    time, on_path, error = trace.time_s, trace.on_path, trace.position_error
    since = time - onset
    return row | {
        "before_onset_rmse_m": rms(error[on_path & (since < 0.0)]),
        "after_onset_rmse_m": rms(error[on_path & (since >= 0.0) & (since < AFTER_ONSET_S)]),
        "settled_after_onset_rmse_m": rms(error[on_path & (since >= SETTLED_AFTER_ONSET_S)]),
        "recovery_s": recovery_s(since[on_path], trace.attitude_error[on_path]),
    }


def recovery_s(since_s: Array, attitude_error: Array) -> float:
    """Return the time from the fault to the first second with an attitude error below 5 degrees; NaN for none.

    Parameters
    ----------
    since_s: [n], time since the fault, s, ascending.
    attitude_error: [n], rad.
    """
    after = since_s >= 0.0
    time, bad = since_s[after], attitude_error[after] >= RECOVERED_RAD
    if time.size == 0:
        return math.nan
    starts = np.concatenate([[0.0], time[bad]])
    ends = np.concatenate([time[bad], time[-1:]])
    long_enough = np.flatnonzero(ends - starts >= RECOVERED_FOR_S)
    return float(starts[long_enough[0]]) if long_enough.size else math.nan


def empty_row() -> Row:
    """Return a row without any results."""
    row: Row = dict.fromkeys(_TEXTS, "") | dict.fromkeys(_INTEGERS, 0) | dict.fromkeys(_FLOATS, math.nan)
    return row | {"survived": False, "lap_rmse_m": []}


def point_of(row: Row) -> dict[str, Any]:
    """Return the point of the sweeps that a row belongs to."""
    point: dict[str, Any] = json.loads(row["point"])
    return point


def outcomes(rows: Iterable[Row]) -> dict[int, bool]:
    """Return whether the vehicle survived, by seed."""
    return {row["seed"]: bool(row["survived"]) for row in rows}
