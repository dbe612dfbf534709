"""Recorded flights of others: reads their columns, and measures what the learner leaves of a residual.

Every prediction is made AHEAD_S ahead: at the signals of now, with a last layer that has seen no residual of the last
AHEAD_S. A prediction of the next sample would be no measure, since residuals change slowly: their own average does it.
"""

import csv
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from async_dmrac.learner import Learner
from configs.loader import ConfigError
from protocol.conventions import Array

Mask: TypeAlias = NDArray[np.bool_]
"""Which rows."""
AHEAD_S: Final = 0.16
SLOPE_ROWS: Final = 5
"""Rows on each side of a slope."""
LAGS_S: Final = tuple(0.01 * k for k in range(13))
"""Lags of the motors that `fit_lag` tries."""
BIASES_S: Final = (0.03, 0.1, 0.3, 1.0, 3.0)
RATE_TOLERANCE: Final = 0.1
"""By which the rates of flights may differ to be learnt from together."""


@dataclass(frozen=True, eq=False)
class Samples:
    """The samples of one flight, in the order of time."""

    name: str
    rate_hz: float
    signals: Array
    """[n, m], what the learner sees."""
    residual: Array
    """[n, q], what the vehicle's model leaves."""


@dataclass(frozen=True)
class Left:
    """Root mean square of the residual of one flight that a model leaves, over samples and outputs, in its unit."""

    flight: str
    samples: int
    zero: float
    """No model."""
    bias: float
    """A bias alone: the residual's average, with that time constant of BIASES_S that fits the training flights best."""
    untrained: float
    """Random features, last layer adapted."""
    held: float
    """Trained features with their trained last layer, not adapted."""
    adapted: float
    """Trained features, last layer adapted."""


def read_columns(path: Path, names: Sequence[str]) -> dict[str, Array]:
    """Read columns of numbers: name -> [n]. An empty cell and `nan` are NaN.

    Raises
    ------
    ConfigError
        Naming the file, the line and the column that does not fit.
    """
    with path.open(encoding="utf-8", newline="") as file:
        reader = csv.reader(file)
        header = next(reader, [])
        missing = [name for name in names if name not in header]
        if missing:
            raise ConfigError(f"{path}: no column {missing[0]!r}; there are {', '.join(header) or 'none'}")
        rows = [row for row in reader if row]
    if len(rows) < 2:
        raise ConfigError(f"{path}: {len(rows)} samples, expected at least 2")
    return {name: _numbers(path, rows, header.index(name), name) for name in names}


def median_rate_hz(path: Path, time_s: Array) -> float:
    """Samples per second. Raises ConfigError, naming `path`, if the time does not increase."""
    steps = np.diff(time_s)
    if not (steps > 0.0).all():
        line = int(np.flatnonzero(~(steps > 0.0))[0]) + 3
        raise ConfigError(f"{path}: line {line}: the time does not increase")
    return 1.0 / float(np.median(steps))


def same_rate(rates_hz: Sequence[float]) -> list[bool]:
    """Whether each rate is near the median of them all."""
    middle = float(np.median(rates_hz)) if rates_hz else 0.0
    return [abs(rate_hz - middle) <= RATE_TOLERANCE * middle for rate_hz in rates_hz]


def slope(values: Array, time_s: Array) -> Array:
    """[n, q], change per second of `values` [n, q] over SLOPE_ROWS on each side; NaN at both ends."""
    rows = SLOPE_ROWS
    found = np.full(values.shape, np.nan)
    between = time_s[2 * rows :] - time_s[: -2 * rows]
    found[rows:-rows] = (values[2 * rows :] - values[: -2 * rows]) / between[:, None]
    return found


def lagged(commands: Array, rate_hz: float, lag_s: float) -> Array:
    """Commands [n, k] behind a first-order lag of `lag_s`, from their first value on."""
    if lag_s == 0.0:
        return commands
    keep = float(np.exp(-1.0 / (rate_hz * lag_s)))
    found: Array = lfilter([1.0 - keep], [1.0, -keep], commands, axis=0, zi=keep * commands[:1])[0]
    return found


def filled(values: Array) -> Array:
    """[n], each NaN replaced by the last number before it; at the start, by the first number."""
    known = np.flatnonzero(~np.isnan(values))
    if known.size == 0:
        return values
    newest = np.searchsorted(known, np.arange(len(values)), side="right") - 1
    found: Array = values[known[np.maximum(newest, 0)]]
    return found


def fit_lag(design: Callable[[float], tuple[Array, Array]]) -> tuple[float, Array]:
    """The lag of LAGS_S with which a linear model fits best, and its coefficients [p].

    Parameters
    ----------
    design: of a lag, s; returns regressors [n, p] and what they are to give [n].
    """
    best: tuple[float, float, Array] | None = None
    for lag_s in LAGS_S:
        X, y = design(lag_s)
        coefficients = np.asarray(np.linalg.lstsq(X, y, rcond=None)[0], dtype=np.float64)
        left = rms(y - X @ coefficients)
        if best is None or left < best[0]:
            best = left, lag_s, coefficients
    assert best is not None
    return best[1], best[2]


def compare(
    training: Sequence[Samples], tested: Sequence[Samples], inputs: Sequence[str], outputs: Sequence[str], rounds: int
) -> list[Left]:
    """Train on some flights, then predict others AHEAD_S ahead.

    Parameters
    ----------
    training, tested: flights of one rate, `same_rate`.
    inputs, outputs: names of the columns of `signals` and `residual`. rounds: of training.
    """
    rate_hz = training[0].rate_hz
    signals, residual = (np.vstack(parts) for parts in zip(*((f.signals, f.residual) for f in training), strict=True))
    sizes = np.maximum(np.sqrt(np.square(residual).mean(axis=0)), 1e-9)
    spread = np.maximum(signals.std(axis=0), 1e-9)
    scales = dict(zip(inputs, zip(signals.mean(axis=0), spread, strict=True), strict=True))

    def learner() -> Learner:
        usual = dict(zip(outputs, sizes.tolist(), strict=True))
        return Learner(inputs, outputs, rate_hz=rate_hz, input_scales=scales, output_scales=usual)

    trained, untrained = learner(), learner()
    trained.fit(signals, residual, rounds=rounds)
    bias_s = min(BIASES_S, key=lambda one: _left_by_bias(training, one))
    return [_left(flight, trained, untrained, bias_s) for flight in tested]


def rms(errors: Array) -> float:
    """Root mean square over all elements."""
    return float(np.sqrt(np.square(errors).mean()))


def _left(flight: Samples, trained: Learner, untrained: Learner, bias_s: float) -> Left:
    truth = flight.residual
    trained.restart()
    held = trained.predict(flight.signals)
    return Left(
        flight.name,
        len(truth),
        rms(truth),
        rms(truth - _bias_ahead(flight, bias_s)),
        rms(truth - _ahead(untrained, flight)),
        rms(truth - held),
        rms(truth - _ahead(trained, flight)),
    )


def _ahead(learner: Learner, flight: Samples) -> Array:
    """[n, q], predicted AHEAD_S ahead."""
    late, predicted = round(AHEAD_S * flight.rate_hz), np.zeros_like(flight.residual)
    learner.restart()
    for row, x in enumerate(flight.signals):
        if row >= late:
            learner.update(flight.signals[row - late], flight.residual[row - late])
        predicted[row] = learner.predict(x)
    return predicted


def _bias_ahead(flight: Samples, bias_s: float) -> Array:
    """[n, q]: the average so far, from 0 on, AHEAD_S ahead."""
    late, predicted = round(AHEAD_S * flight.rate_hz), np.zeros_like(flight.residual)
    keep = float(np.exp(-1.0 / (flight.rate_hz * bias_s)))
    predicted[late:] = lfilter([1.0 - keep], [1.0, -keep], flight.residual, axis=0)[: len(predicted) - late]
    return predicted


def _left_by_bias(flights: Sequence[Samples], bias_s: float) -> float:
    return rms(np.vstack([one.residual - _bias_ahead(one, bias_s) for one in flights]))


def _numbers(path: Path, rows: Sequence[Sequence[str]], column: int, name: str) -> Array:
    values = np.empty(len(rows))
    for number, row in enumerate(rows):
        try:
            values[number] = float(row[column] or "nan")
        except (IndexError, ValueError):
            found: Any = row[column] if column < len(row) else "no cell"
            raise ConfigError(f"{path}: line {number + 2}, column {name!r}: {found!r}: expected a number") from None
    return values
