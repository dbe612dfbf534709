"""The learner on the flights of NanoBench (Ullah and Baca 2026, github.com/syediu/nanobench-iros2026, BSD-3).

A Crazyflie 2.1 under motion capture: a table TRAJECTORY_repN.csv per flight in `datasets/dataset`. Columns and units
are as in their README, except that `roll`, `pitch` and `yaw` are in radians and that `att_stateEstimate_pitch` has the
opposite sign. Neither is used here: the quaternions agree with each other.

The residual, per unit of mass, in the frame of their motion capture (z up):

    residual = dv/dt + g e3 - R e3 k(V) sum u_i^2,    k(V) = k0 + k1 V + k2 V^2

with the motor commands u_i (0 to 1, behind a lag) and the battery's voltage V. It is their voltage-conditioned model of
the thrust; k and the lag are fitted here on the training flights. Onboard columns are some rows late against the motion
capture: `late_rows`.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from async_dmrac.benchmarks.recordings import (
    Left,
    Mask,
    Samples,
    compare,
    filled,
    fit_lag,
    lagged,
    median_rate_hz,
    read_columns,
    same_rate,
    slope,
)
from configs.loader import ConfigError
from protocol.conventions import GRAVITY, Array

WHERE: Final = (
    "get it with: git clone https://github.com/syediu/nanobench-iros2026; the folder is nanobench-iros2026 itself"
)
FLIGHTS: Final = Path("datasets/dataset")
POSITION: Final = ("px", "py", "pz")
ATTITUDE: Final = ("qx", "qy", "qz", "qw")
VELOCITY: Final = ("vx", "vy", "vz")
FORCE: Final = ("imu_acc_x", "imu_acc_y", "imu_acc_z")
RATE: Final = ("imu_gyro_x", "imu_gyro_y", "imu_gyro_z")
MOTORS: Final = ("motor_motor_m1", "motor_motor_m2", "motor_motor_m3", "motor_motor_m4")
BATTERY: Final = "pwr_pm_vbat"
EKF_VELOCITY: Final = ("est_stateEstimate_vx", "est_stateEstimate_vy", "est_stateEstimate_vz")
EKF_ATTITUDE: Final = tuple(f"att_stateEstimate_{name}" for name in ATTITUDE)
COLUMNS: Final = (
    *("t", *POSITION, *ATTITUDE, *VELOCITY),
    *(*FORCE, *RATE, *MOTORS, BATTERY),
    *(*EKF_VELOCITY, *EKF_ATTITUDE),
)
FULL_PWM: Final = 65535.0
RUNNING: Final = 1000.0 / FULL_PWM
"""A motor runs above it: their threshold."""
AIRBORNE_M: Final = 0.3
"""Above it in the motion capture's frame, the floor has no effect. Their vehicle stands at 0.07 m."""
SAMPLES_MIN: Final = 200
"""Flights with fewer samples are left out: their limit."""
WHOLE_SHARE_MIN: Final = 0.9
"""Fewer quaternions of unit length are another column; others are moments without a pose, and left out."""
LATE_ROWS_MAX: Final = 10
REPETITION: Final = re.compile(r"^(.+)_rep(\d+)$")
INPUTS: Final = (*VELOCITY, *ATTITUDE, *MOTORS, BATTERY)
OUTPUTS: Final = ("x", "y", "z")
"""m/s^2."""


@dataclass(frozen=True, eq=False)
class Flight:
    """A flight of theirs, without the rows in which a number or a pose is missing. World frame z up, body z up."""

    name: str
    time_s: Array
    rate_hz: float
    position: Array
    """[n, 3] m, motion capture."""
    attitude: Array
    """[n, 4] xyzw, body to world, motion capture."""
    velocity: Array
    """[n, 3] m/s, motion capture."""
    force: Array
    """[n, 3] m/s^2, accelerometer, body."""
    rate: Array
    """[n, 3] rad/s, gyroscope, body."""
    motors: Array
    """[n, 4] commands, 0 to 1."""
    battery: Array
    """[n] V."""
    ekf_velocity: Array
    """[n, 3] m/s, onboard."""
    ekf_attitude: Array
    """[n, 4] xyzw, onboard."""

    @property
    def running(self) -> Mask:
        """[n] bool: motor 1 runs, which they call flight."""
        found: Mask = self.motors[:, 0] > RUNNING
        return found

    def late_rows(self) -> int:
        """Rows by which the onboard columns are late: where the gyroscope fits the motion capture's rates best."""
        turned = Rotation.from_quat(self.attitude)
        rates = np.full(self.rate.shape, np.nan)
        between = self.time_s[4:] - self.time_s[:-4]
        rates[2:-2] = (turned[:-4].inv() * turned[4:]).as_rotvec() / between[:, None]
        used, count = self.running, len(rates)
        used[:2] = used[-2:] = False
        errors = []
        for late in range(LATE_ROWS_MAX + 1):
            rows = np.flatnonzero(used[: count - late])
            errors.append(np.square(self.rate[rows + late] - rates[rows]).mean() if rows.size else 0.0)
        return int(np.argmin(errors))

    def aligned(self) -> "Flight":
        """The flight with its onboard columns moved by `late_rows`, on the clock of the motion capture."""
        late = self.late_rows()
        onboard = ("force", "rate", "motors", "battery", "ekf_velocity", "ekf_attitude")
        end = len(self.time_s) - late
        captured = {name: getattr(self, name)[:end] for name in ("time_s", "position", "attitude", "velocity")}
        return replace(self, **captured, **{name: getattr(self, name)[late:] for name in onboard})


@dataclass(frozen=True, eq=False)
class ThrustCurve:
    """Thrust per unit of mass of a sum of squared motor commands, m/s^2."""

    k: Array
    """[3], of 1, V and V^2."""
    lag_s: float

    def thrust(self, flight: Flight) -> Array:
        """[n]."""
        found: Array = _regressors(flight, self.lag_s) @ self.k
        return found


@dataclass(frozen=True)
class Result:
    """Of the learner."""

    curve_k: tuple[float, ...]
    """Fitted on the training flights."""
    motor_lag_s: float
    flights: list[Left]
    """Held-out flights."""
    left_out: list[str]
    """Flights with too few samples in the air, or at another rate than most."""


def read_flight(path: Path) -> Flight:
    """Read a flight.

    Raises
    ------
    ConfigError
        Naming the file, the line and the column that does not fit.
    """
    columns = read_columns(path, COLUMNS)
    battery = columns[BATTERY]
    battery[battery == 0.0] = np.nan  # not measured yet: they do the same
    for name in (*MOTORS, BATTERY):
        columns[name] = filled(columns[name])
    table = np.column_stack([columns[name] for name in COLUMNS])
    whole = table[np.isfinite(table).all(axis=1)]
    for names in (ATTITUDE, EKF_ATTITUDE):
        norms = np.linalg.norm(whole[:, [COLUMNS.index(name) for name in names]], axis=1)
        unit = np.abs(norms - 1.0) < 0.01
        if len(unit) and unit.mean() < WHOLE_SHARE_MIN:
            raise ConfigError(f"{path}: columns {', '.join(names)}: the quaternions are not of unit length")
        whole = whole[unit]
    if len(whole) < 2:
        raise ConfigError(f"{path}: {len(whole)} rows with all numbers, expected at least 2")

    def part(names: Sequence[str]) -> Array:
        found: Array = whole[:, [COLUMNS.index(name) for name in names]]
        return found

    time_s = whole[:, 0]
    return Flight(
        path.stem,
        time_s,
        median_rate_hz(path, time_s),
        part(POSITION),
        part(ATTITUDE),
        part(VELOCITY),
        part(FORCE) * GRAVITY,
        part(RATE),
        part(MOTORS) / FULL_PWM,
        part((BATTERY,))[:, 0],
        part(EKF_VELOCITY),
        part(EKF_ATTITUDE),
    )


def read_flights(folder: Path) -> list[Flight]:
    """All flights of a folder, by name. Raises ConfigError if there are none or one does not fit."""
    files = sorted(folder.glob("*_rep*.csv"))
    if not files:
        raise ConfigError(f"{folder}: no files TRAJECTORY_repN.csv of NanoBench; {WHERE}")
    return [read_flight(path) for path in files]


def learner_result(folder: Path, rounds: int = 30) -> Result:
    """Hold out the last repetition of each trajectory that was flown more than once, and train on all others.

    Parameters
    ----------
    folder: their repository. rounds: of training.

    Raises
    ------
    ConfigError
        If a folder or file is missing, or does not have their format, or no trajectory was flown twice.
    """
    flights = [one.aligned() for one in read_flights(folder / FLIGHTS)]
    same = same_rate([one.rate_hz for one in flights])
    usable = [
        one for one, fits in zip(flights, same, strict=True) if fits and np.count_nonzero(_in_air(one)) >= SAMPLES_MIN
    ]
    held = _last_repetitions([one.name for one in usable])
    if not held:
        raise ConfigError(f"{folder / FLIGHTS}: no trajectory with two flights; {WHERE}")
    training = [one for one in usable if one.name not in held]
    curve = fit_thrust(training)
    found = compare(
        [samples(one, curve) for one in training],
        [samples(one, curve) for one in usable if one.name in held],
        INPUTS,
        OUTPUTS,
        rounds,
    )
    short = [one.name for one in flights if one not in usable]
    return Result(tuple(curve.k.tolist()), curve.lag_s, found, short)


def fit_thrust(flights: Sequence[Flight]) -> ThrustCurve:
    """Fit the thrust curve to the force along the body's z axis, on rows in the air."""
    along = np.concatenate([(_world_force(one) * _up(one)).sum(axis=1)[_in_air(one)] for one in flights])

    def design(lag_s: float) -> tuple[Array, Array]:
        return np.vstack([_regressors(one, lag_s)[_in_air(one)] for one in flights]), along

    lag_s, k = fit_lag(design)
    return ThrustCurve(k, lag_s)


def samples(flight: Flight, curve: ThrustCurve) -> Samples:
    """The learner's samples: signals INPUTS and the residual in m/s^2, of the rows in the air."""
    rows = _in_air(flight)
    attitude = flight.attitude * np.where(flight.attitude[:, 3:] < 0.0, -1.0, 1.0)
    motors = lagged(flight.motors, flight.rate_hz, curve.lag_s)
    signals = np.column_stack([flight.velocity, attitude, motors, flight.battery])
    residual = _world_force(flight) - _up(flight) * curve.thrust(flight)[:, None]
    return Samples(flight.name, flight.rate_hz, signals[rows], residual[rows])


def _in_air(flight: Flight) -> Mask:
    """[n] bool: all motors run, away from the floor, with a slope of the velocity."""
    ends = np.isfinite(slope(flight.velocity, flight.time_s)).all(axis=1)
    found: Mask = (flight.motors > RUNNING).all(axis=1) & (flight.position[:, 2] > AIRBORNE_M) & ends
    return found


def _world_force(flight: Flight) -> Array:
    """[n, 3], acceleration without gravity, m/s^2."""
    found: Array = slope(flight.velocity, flight.time_s) + np.array([0.0, 0.0, GRAVITY])
    return found


def _up(flight: Flight) -> Array:
    """[n, 3], R e3: where the thrust points."""
    found: Array = Rotation.from_quat(flight.attitude).apply([0.0, 0.0, 1.0])
    return found


def _regressors(flight: Flight, lag_s: float) -> Array:
    """[n, 3], sum of the squared commands times 1, V and V^2."""
    squares = np.square(lagged(flight.motors, flight.rate_hz, lag_s)).sum(axis=1)
    found: Array = squares[:, None] * flight.battery[:, None] ** np.arange(3)
    return found


def _last_repetitions(names: Sequence[str]) -> set[str]:
    """Of each trajectory that has more than one."""
    by_trajectory: dict[str, list[tuple[int, str]]] = {}
    for name in names:
        if found := REPETITION.match(name):
            by_trajectory.setdefault(found[1], []).append((int(found[2]), name))
    return {max(flown)[1] for flown in by_trajectory.values() if len(flown) > 1}
