"""The learner on the flights of CrazyPAD (Masalimov et al. 2024, github.com/AerialRoboticsUUST/CrazyPAD, MIT).

A Crazyflie 2.1 with cut or taped rotors, weights, or weights on a string flies 2 m to and fro. There are two kinds of
logs, tables CONDITION/LOG.csv; no flight is in both. There is no motion capture, and neither a raw IMU nor the pitch is
logged, so no estimator can be run on them: all is as the Crazyflie estimated it.

    motor_data       |a + g e3| = c sum m_i + residual        m/s^2, thrust per unit of mass
    controller_data  d omega/dt = b cmd + residual            rad/s^2, for roll, pitch and yaw

m_i are the thrusts that the firmware asks of the motors (it allows for the battery's voltage), cmd its commands of the
axes, both as a part of 65535 and behind a lag; the firmware counts pitch and yaw its own way, alike in both. c, b and
the lags are fitted on training flights without damage.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

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

WHERE: Final = "get it with: git clone https://github.com/AerialRoboticsUUST/CrazyPAD; the folder is CrazyPAD/data"
NORMAL: Final = "normal_flight"
"""The folder of flights without damage."""
FULL: Final = 65535.0
RUNNING: Final = 10_000.0 / FULL
"""A commanded thrust above it lifts off or flies: they hover at 40 000."""
AIRBORNE_M: Final = 0.2
"""They fly at 0.5 m; after a landing, their estimate of the height is off by up to 0.1 m."""
SAMPLES_MIN: Final = 200

TIME: Final = "timestamp"
"""ms."""
HEIGHT: Final = "stateEstimate.z"
MOTORS: Final = ("motor.m1", "motor.m2", "motor.m3", "motor.m4")
BATTERY: Final = "pm.vbatMV"
VELOCITY: Final = ("stateEstimate.vx", "stateEstimate.vy", "stateEstimate.vz")
ACCELERATION: Final = ("stateEstimate.ax", "stateEstimate.ay", "stateEstimate.az")
"""g, world frame, without gravity."""
RATES: Final = ("controller.r_roll", "controller.r_pitch", "controller.r_yaw")
"""rad/s."""
COMMANDS: Final = ("controller.cmd_roll", "controller.cmd_pitch", "controller.cmd_yaw")
THRUST: Final = "controller.cmd_thrust"


@dataclass(frozen=True, eq=False)
class Log:
    """A log of theirs: signals and the commands that act, and what they act on."""

    name: str
    """CONDITION/LOG."""
    condition: str
    rate_hz: float
    commands: Array
    """[n, q], part of full: the sum of the motors, or of roll, pitch and yaw."""
    motion: Array
    """[n, q]: thrust per unit of mass, m/s^2, or angular acceleration, rad/s^2."""
    others: Array
    """[n, m], the further signals."""
    flying: Mask
    """[n] bool: in the air, with all numbers."""


@dataclass(frozen=True)
class Kind:
    """A kind of log."""

    folder: str
    unit: str
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    """Names of the signals: the commands first."""
    read: Callable[[Path], Log]


@dataclass(frozen=True)
class Result:
    """Of the learner on one kind of log."""

    kind: str
    unit: str
    gains: tuple[float, ...]
    """Of the commands, per output, fitted on the training flights without damage."""
    motor_lag_s: tuple[float, ...]
    flights: list[Left]
    """One held-out flight per condition."""
    left_out: list[str]
    """Logs with too few samples in the air, or at another rate than most."""


def read_motor_log(path: Path) -> Log:
    """Read a log of `motor_data`.

    Raises
    ------
    ConfigError
        Naming the file, the line and the column that does not fit.
    """
    columns = read_columns(path, (TIME, *MOTORS, BATTERY, HEIGHT, *VELOCITY, *ACCELERATION))
    motors = np.column_stack([filled(columns[name]) for name in MOTORS]) / FULL
    specific = np.column_stack([columns[name] for name in ACCELERATION]) + np.array([0.0, 0.0, 1.0])
    motion = GRAVITY * np.linalg.norm(specific, axis=1)[:, None]
    volts = 1e-3 * filled(columns[BATTERY])
    others = np.column_stack([*(columns[name] for name in VELOCITY), motors, volts])
    flying: Mask = (motors > RUNNING).all(axis=1) & (columns[HEIGHT] > AIRBORNE_M)
    return _log(path, columns[TIME], motors.sum(axis=1)[:, None], motion, others, flying)


def read_controller_log(path: Path) -> Log:
    """Read a log of `controller_data`. Raises ConfigError as `read_motor_log` does."""
    columns = read_columns(path, (TIME, HEIGHT, THRUST, *COMMANDS, *RATES))
    rates = np.column_stack([columns[name] for name in RATES])
    commands = np.column_stack([filled(columns[name]) for name in COMMANDS]) / FULL
    thrust = filled(columns[THRUST]) / FULL
    flying: Mask = (thrust > RUNNING) & (columns[HEIGHT] > AIRBORNE_M)
    motion = slope(rates, 1e-3 * columns[TIME])
    return _log(path, columns[TIME], commands, motion, np.column_stack([rates, thrust]), flying)


KINDS: Final = (
    Kind(
        "motor_data",
        "m/s^2",
        ("thrust",),
        ("motors", *VELOCITY, *MOTORS, BATTERY),
        read_motor_log,
    ),
    Kind(
        "controller_data",
        "rad/s^2",
        ("roll", "pitch", "yaw"),
        (*COMMANDS, *RATES, THRUST),
        read_controller_log,
    ),
)


def results(folder: Path, rounds: int = 30) -> list[Result]:
    """Both kinds of log: hold out the last log of each condition that has more than one, train on all others.

    Parameters
    ----------
    folder: their `data`. rounds: of training.

    Raises
    ------
    ConfigError
        If a folder or file is missing, or does not have their format.
    """
    return [_result(folder / kind.folder, kind, rounds) for kind in KINDS]


def fit_gains(logs: Sequence[Log]) -> tuple[Array, Array]:
    """Gain [q] and lag [q] s of the commands, of each output alone, on rows in the air.

    With several outputs, a constant is fitted with each gain and left in the residual: the trim of the vehicle.
    """
    gains, lags = [], []
    for output in range(logs[0].motion.shape[1]):

        def design(lag_s: float, output: int = output) -> tuple[Array, Array]:
            commands = np.concatenate([lagged(one.commands, one.rate_hz, lag_s)[one.flying, output] for one in logs])
            constant = np.ones_like(commands)
            X = np.column_stack([commands, constant]) if logs[0].motion.shape[1] > 1 else commands[:, None]
            return X, np.concatenate([one.motion[one.flying, output] for one in logs])

        lag_s, coefficients = fit_lag(design)
        gains.append(coefficients[0])
        lags.append(lag_s)
    return np.array(gains), np.array(lags)


def samples(log: Log, gains: Array, lags_s: Array) -> Samples:
    """The learner's samples, of the rows in the air: the commands behind their lags, and the further signals."""
    late = np.column_stack([lagged(log.commands[:, [k]], log.rate_hz, float(lag_s)) for k, lag_s in enumerate(lags_s)])
    signals, residual = np.column_stack([late, log.others]), log.motion - late * gains
    return Samples(log.name, log.rate_hz, signals[log.flying], residual[log.flying])


def _result(folder: Path, kind: Kind, rounds: int) -> Result:
    by_condition: dict[str, list[Path]] = {}
    for path in sorted(folder.glob("*/*.csv")):
        by_condition.setdefault(path.parent.name, []).append(path)
    if NORMAL not in by_condition:
        raise ConfigError(f"{folder}: no folder {NORMAL} with .csv files of CrazyPAD; {WHERE}")
    every = [kind.read(path) for paths in by_condition.values() for path in paths]
    usable: dict[str, list[Log]] = {}
    left_out = []
    for log, fits in zip(every, same_rate([log.rate_hz for log in every]), strict=True):
        if fits and np.count_nonzero(log.flying) >= SAMPLES_MIN:
            usable.setdefault(log.condition, []).append(log)
        else:
            left_out.append(log.name)
    held = [logs[-1] for logs in usable.values() if len(logs) > 1]
    training = [one for logs in usable.values() for one in (logs[:-1] if len(logs) > 1 else logs)]
    normal = [one for one in training if one.condition == NORMAL]
    if not normal or not held:
        raise ConfigError(f"{folder}: expected two flights of {NORMAL} with {SAMPLES_MIN} samples in the air")
    gains, lags_s = fit_gains(normal)
    found = compare(
        [samples(one, gains, lags_s) for one in training],
        [samples(one, gains, lags_s) for one in held],
        kind.inputs,
        kind.outputs,
        rounds,
    )
    return Result(kind.folder, kind.unit, tuple(gains.tolist()), tuple(lags_s.tolist()), found, left_out)


def _log(path: Path, time_ms: Array, commands: Array, motion: Array, others: Array, flying: Mask) -> Log:
    """A log; rows with a missing number do not fly."""
    whole = np.all(np.isfinite(np.column_stack([commands, motion, others])), axis=1)
    rate_hz = median_rate_hz(path, 1e-3 * time_ms)
    return Log(
        f"{path.parent.name}/{path.stem}",
        path.parent.name,
        rate_hz,
        commands,
        motion,
        others,
        flying & whole,
    )
