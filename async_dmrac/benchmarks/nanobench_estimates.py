"""The onboard estimator on the readings of NanoBench's trefoil flights, beside the Crazyflie's own estimate.

Their tables have accelerometer and gyroscope, at 100 rows/s, and no optical flow, range or pressure. So the estimator
gets the IMU and poses of the motion capture, 100/s or 10/s. What the Crazyflie's own filter was given is not in their
files. Both are compared with the motion capture while motor 1 runs, their definition of flight, from SETTLED_S after
the estimator's start on. It starts at the first half second without fast rotation, because some of their tables begin
in flight.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from async_dmrac.benchmarks.nanobench import RUNNING, SAMPLES_MIN, Flight, read_flights
from async_dmrac.benchmarks.recordings import Mask, rms
from onboard.estimation.config import EstimatorConfig
from onboard.estimation.estimator import Estimator
from protocol.conventions import Array
from protocol.mavlink.vehicle import ImuReading
from protocol.messages import Pose

FOLDERS: Final = (
    Path("benchmarks/task3_stateEst/mellinger_trefoil"),
    Path("benchmarks/task3_stateEst/pid_trefoil"),
)
SPEEDS: Final = ("slow", "medium", "fast")
PUBLISHED_M_S: Final = {"slow": 0.069, "medium": 0.067, "fast": 7.629}
"""Mean over flights of the RMSE of the onboard filter's velocity: task3_trefoil_table.csv of their repository.

Their attitude error there (2.12, 2.71, 29.67 deg) takes radians from degrees and is no error of the attitude.
"""
FLIP: Final = np.array([1.0, -1.0, -1.0])
"""Z up to z down: half a turn about x, of the world and of the body."""
SPARSE_HZ: Final = 10.0
SETTLED_S: Final = 2.0


@dataclass(frozen=True)
class Estimates:
    """Root mean square errors of one flight against the motion capture: of the velocity vector, and of the attitude."""

    flight: str
    """With its folder: both controllers have flights of the same name."""
    speed: str
    late_s: float
    """By which the onboard columns are late. All but `logged_m_s` is free of it."""
    compared_s: float
    """Of the flight, by all but `logged_m_s`."""
    logged_m_s: float
    """Of the Crazyflie's filter as logged, over the whole flight: their measure."""
    theirs_m_s: float
    theirs_deg: float
    """Of the Crazyflie's filter."""
    ours_m_s: float
    ours_deg: float
    """Of our estimator with a pose in each row."""
    sparse_m_s: float
    sparse_deg: float
    """With SPARSE_HZ poses a second."""


@dataclass(frozen=True)
class OfSpeed:
    """Means over the flights of one speed."""

    speed: str
    flights: int
    published_m_s: float
    logged_m_s: float
    theirs_m_s: float
    theirs_deg: float
    ours_m_s: float
    ours_deg: float
    sparse_m_s: float
    sparse_deg: float


def estimates(folder: Path) -> tuple[list[Estimates], list[str]]:
    """Run the estimator on each trefoil flight of their repository; also the names of flights that are left out.

    A flight is left out if what can be compared is shorter than their limit of SAMPLES_MIN rows.

    Raises
    ------
    ConfigError
        If a folder or file is missing, or does not have their format.
    """
    found, left_out = [], []
    for part in FOLDERS:
        for flight in read_flights(folder / part):
            name = f"{part.name}/{flight.name}"
            one = _errors(name, flight) if np.count_nonzero(flight.running) >= SAMPLES_MIN else None
            if one is None:
                left_out.append(name)
            else:
                found.append(one)
    return found, left_out


def by_speed(found: Sequence[Estimates]) -> list[OfSpeed]:
    """Means of each speed, in the order of their table."""
    rows = []
    for speed in SPEEDS:
        flights = [one for one in found if one.speed == speed]
        if flights:
            names = ("logged_m_s", "theirs_m_s", "theirs_deg", "ours_m_s", "ours_deg", "sparse_m_s", "sparse_deg")
            means = [float(np.mean([getattr(one, name) for one in flights])) for name in names]
            rows.append(OfSpeed(speed, len(flights), PUBLISHED_M_S[speed], *means))
    return rows


def estimate(flight: Flight, pose_hz: float) -> tuple[Array, Array]:
    """Velocity [n, 3] m/s and attitude [n, 4] xyzw by our estimator, z up; NaN before its start.

    Parameters
    ----------
    flight: aligned. pose_hz: poses per second, at most one a row.
    """
    # A row has the values at its time. Rows are interpolated: equal ones do not mean a stuck gyroscope.
    estimator = Estimator(EstimatorConfig(gyro_delay_s=0.0, gyro_stuck_samples=0))
    stopped = np.all(flight.motors < RUNNING, axis=1)
    first = int(np.argmin(stopped))
    every = max(round(flight.rate_hz / pose_hz), 1)
    time_ns = np.round((flight.time_s - flight.time_s[0]) * 1e9).astype(np.int64) + 1_000_000_000
    force, rate = flight.force * FLIP, flight.rate * FLIP
    force[1:] = 0.5 * (force[:-1] + force[1:])  # the estimator expects the mean since the reading before
    position = (flight.position * FLIP).astype(np.float32)
    turned = (flight.attitude[:, [3, 0, 1, 2]] * np.array([1.0, 1.0, -1.0, -1.0])).astype(np.float32)
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    velocity, attitude = np.full((len(force), 3), np.nan), np.full((len(force), 4), np.nan)
    for row, now in enumerate(time_ns.tolist()):
        estimator.set_on_ground(bool(stopped[row]), at_rest=row < first)
        a, w = force[row].tolist(), rate[row].tolist()
        estimator.receive(ImuReading(now, (a[0], a[1], a[2]), (w[0], w[1], w[2])))
        if row % every == 0:
            estimator.receive_pose(Pose(now, position[row], turned[row]), now, now)
        if estimator.state.initialised:
            velocity[row] = estimator.state.velocity * FLIP
            w_, x, y, z = estimator.state.quaternion.tolist()
            attitude[row] = x, -y, -z, w_
    return velocity, attitude


def _errors(name: str, flight: Flight) -> Estimates | None:
    logged = _velocity_error(flight, flight.ekf_velocity, flight.running)
    late, aligned = flight.late_rows(), flight.aligned()
    dense, sparse = estimate(aligned, flight.rate_hz), estimate(aligned, SPARSE_HZ)
    begun = np.flatnonzero(np.isfinite(dense[0]).all(axis=1))
    if not begun.size:
        return None
    rows: Mask = aligned.running & (aligned.time_s >= aligned.time_s[begun[0]] + SETTLED_S)
    compared = int(np.count_nonzero(rows))
    if compared < SAMPLES_MIN:
        return None
    errors = [
        of(aligned, given, rows)
        for pair in ((aligned.ekf_velocity, aligned.ekf_attitude), dense, sparse)
        for of, given in zip((_velocity_error, _attitude_error_deg), pair, strict=True)
    ]
    speed = next((one for one in SPEEDS if f"_{one}_" in flight.name), "other")
    return Estimates(name, speed, late / flight.rate_hz, compared / flight.rate_hz, logged, *errors)


def _velocity_error(flight: Flight, velocity: Array, rows: Mask) -> float:
    """m/s, of the vector."""
    return rms(np.linalg.norm(velocity[rows] - flight.velocity[rows], axis=1))


def _attitude_error_deg(flight: Flight, attitude: Array, rows: Mask) -> float:
    """Angle of the rotation between both."""
    between = Rotation.from_quat(flight.attitude[rows]).inv() * Rotation.from_quat(attitude[rows])
    return float(np.degrees(rms(between.magnitude())))
