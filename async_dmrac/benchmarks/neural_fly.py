"""The learner alone on the flights of Neural-Fly (O'Connell et al. 2022, github.com/aerorobotics/neural-fly).

Their data folder has `training/` and `experiment/` with files VEHICLE_TRAJECTORY_METHOD_CONDITION.csv. A cell is a
number or a list in brackets. What is learnt: the force fa [3] from velocity v [3], attitude q [4] and pwm [4] / 1000,
the inputs of their own training script.
"""

import csv
import json
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from async_dmrac.learner import Learner
from configs.loader import ConfigError
from protocol.conventions import Array

WHERE: Final = "get it with: git clone https://github.com/aerorobotics/neural-fly; the folder is neural-fly/data"
INPUTS: Final = {"v": (3, 1.0), "q": (4, 1.0), "pwm": (4, 1e-3)}
"""Column -> values in a cell, and factor."""
OUTPUT: Final = "fa"
SIGNALS: Final = tuple(f"{name}_{k}" for name, (size, _) in INPUTS.items() for k in range(size))
FORCES: Final = ("fa_x", "fa_y", "fa_z")
TESTED: Final = re.compile(r"^(?:custom_figure8_)?baseline_(\w+)$")
"""The flights that their script tests with: those of the baseline controller."""
PUBLISHED: Final = {"nowind": 0.45, "35wind": 0.74, "70wind": 1.17, "100wind": 1.89}
"""Mean squared error after learning, by condition, as printed in their training-and-validation.ipynb."""


@dataclass(frozen=True, eq=False)
class Recording:
    """A flight of theirs."""

    name: str
    time_s: Array
    """[n]."""
    signals: Array
    """[n, 11], SIGNALS."""
    forces: Array
    """[n, 3], FORCES."""

    @property
    def rate_hz(self) -> float:
        """Samples per second."""
        return 1.0 / float(np.median(np.diff(self.time_s)))


@dataclass(frozen=True)
class Errors:
    """Mean squared errors of the force on one flight, mean over samples and axes, in the square of its unit."""

    condition: str
    samples: int
    zero: float
    """Of no model."""
    mean: float
    """Of the flight's own mean."""
    fitted: float
    """Of the trained features with the last layer that fits the whole flight best: the measure of their script."""
    ahead: float
    """Of the last layer on line, each sample predicted before it is seen."""
    ahead_untrained: float
    """The same with random features and no training."""
    published: float | None
    """`fitted` of their network, as they published it; None for a condition that they did not."""


def read_recording(path: Path) -> Recording:
    """Read a flight.

    Raises
    ------
    ConfigError
        Naming the file, the line and the column that does not fit.
    """
    with path.open(encoding="utf-8", newline="") as file:
        reader = csv.DictReader(file)
        missing = [name for name in ("t", *INPUTS, OUTPUT) if name not in (reader.fieldnames or ())]
        if missing:
            raise ConfigError(f"{path}: no column {missing[0]!r}; there are {', '.join(reader.fieldnames or ())}")
        rows = list(reader)
    if len(rows) < 2:
        raise ConfigError(f"{path}: {len(rows)} samples, expected at least 2")
    signals = np.hstack([_column(path, rows, name, size) * factor for name, (size, factor) in INPUTS.items()])
    return Recording(path.stem, _column(path, rows, "t", 1)[:, 0], signals, _column(path, rows, OUTPUT, 3))


def compare(folder: Path, rounds: int = 30) -> list[Errors]:
    """Train on all flights of `training/`, then predict each flight of `experiment/` with the baseline controller.

    Parameters
    ----------
    folder: their `data`. rounds: of training.

    Raises
    ------
    ConfigError
        If a folder or file is missing, or does not have their format.
    """
    training = _recordings(folder / "training")
    tested = [one for one in _recordings(folder / "experiment") if TESTED.match(one.name)]
    if not tested:
        raise ConfigError(f"{folder / 'experiment'}: no file named [custom_figure8_]baseline_CONDITION.csv")
    forces = np.vstack([one.forces for one in training])
    trained = _learner(training)
    trained.fit(np.vstack([one.signals for one in training]), forces, rounds=rounds)
    return [_errors(one, trained, _learner(training)) for one in tested]


def as_json(found: Sequence[Errors]) -> list[dict[str, Any]]:
    """One record per flight."""
    return [asdict(one) for one in found]


def _learner(training: Sequence[Recording]) -> Learner:
    """A learner with the scales of the training flights, and random features."""
    signals = np.vstack([one.signals for one in training])
    sizes = np.sqrt(np.square(np.vstack([one.forces for one in training])).mean(axis=0))
    spread = np.maximum(signals.std(axis=0), 1e-9)
    return Learner(
        SIGNALS,
        FORCES,
        rate_hz=training[0].rate_hz,
        input_scales=dict(zip(SIGNALS, zip(signals.mean(axis=0), spread, strict=True), strict=True)),
        output_scales=dict(zip(FORCES, sizes.tolist(), strict=True)),
    )


def _errors(flight: Recording, trained: Learner, untrained: Learner) -> Errors:
    truth, condition = flight.forces, TESTED.sub(r"\1", flight.name)
    Phi = trained.features(flight.signals)
    fitted = Phi @ np.linalg.lstsq(Phi, truth, rcond=None)[0]
    return Errors(
        condition,
        len(truth),
        _mse(truth),
        _mse(truth - truth.mean(axis=0)),
        _mse(truth - fitted),
        _mse(truth - _ahead(trained, flight)),
        _mse(truth - _ahead(untrained, flight)),
        PUBLISHED.get(condition),
    )


def _ahead(learner: Learner, flight: Recording) -> Array:
    """[n, 3], each sample predicted before it is seen."""
    predicted = np.zeros_like(flight.forces)
    learner.restart()
    for row, (x, force) in enumerate(zip(flight.signals, flight.forces, strict=True)):
        predicted[row] = learner.predict(x)
        learner.update(x, force)
    return predicted


def _mse(errors: Array) -> float:
    return float(np.square(errors).mean())


def _recordings(folder: Path) -> list[Recording]:
    files = sorted(folder.glob("*.csv"))
    if not files:
        raise ConfigError(f"{folder}: no .csv files of Neural-Fly; {WHERE}")
    return [read_recording(path) for path in files]


def _column(path: Path, rows: Sequence[dict[str, Any]], name: str, size: int) -> Array:
    """[n, size]. Raises ConfigError."""
    values = np.zeros((len(rows), size))
    for number, row in enumerate(rows):
        try:
            values[number] = json.loads(row[name])
        except (TypeError, ValueError):
            raise ConfigError(
                f"{path}: line {number + 2}, column {name!r}: {row[name]!r}: expected {size} numbers"
            ) from None
    if not np.isfinite(values).all():
        raise ConfigError(f"{path}: column {name!r}: a value is not finite")
    return values
