"""Reads traces of a link's dropouts, by name in configs/dropouts: recorded deliveries (.csv) or patterns (.yaml).

A .csv file contains the delivery of each datagram of a flight, one per line:

    # one line of description or more
    direction,sent_ms,outcome,delay_ms,copy_delay_ms,flipped_bit
    down,2015.004,delivered,8.317,,
    up,2020.011,burst,,,

`direction` is up (onboard to offboard) or down; `sent_ms` counts from the start of the flight and does not decrease
within a direction; `outcome` is delivered, loss, burst, blackout or queue; a delay, to microseconds, is empty if that
copy did not arrive; `flipped_bit` is the inverted bit, if any. The datagrams of another flight get these deliveries by
time (sim_vehicle.link.radio.RecordedDeliveries); after the end they get those of the `perfect` radio.

A .yaml file contains a `description`, the name of a profile in configs/radio (`radio`, default perfect) and changes of
it (`radio_values`), as in a scenario. configs/parts.py describes files with several patterns.
"""

import csv
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from pydantic import Field

from configs.loader import CONFIG_DIRECTORY, ConfigError, ConfigRecord, fill, merge
from configs.parts import part_names, read_part
from experiments.flights.lockstep_flight import Deliveries
from sim_vehicle.link.radio import DIRECTIONS, OUTCOMES, Delivery, Direction, RadioConfig

FOLDER: Final = CONFIG_DIRECTORY / "dropouts"
COLUMNS: Final = ("direction", "sent_ms", "outcome", "delay_ms", "copy_delay_ms", "flipped_bit")
SIZE_UNKNOWN: Final = 0
DELAY_MAX_MS: Final = 3_600_000.0


class PatternFile(ConfigRecord):
    """The content of a .yaml trace."""

    description: str
    radio: str = "perfect"
    radio_values: dict[str, Any] = Field(default_factory=dict)


@dataclass(frozen=True)
class DropoutTrace:
    """The behaviour of the link in a flight."""

    name: str
    description: str
    radio: RadioConfig
    deliveries: Deliveries = field(default_factory=dict)
    """Recorded deliveries by direction; empty for a pattern."""


def trace_names() -> list[str]:
    """Return the names of the shipped traces."""
    return sorted([*part_names("dropouts"), *(path.stem for path in FOLDER.glob("*.csv"))])


def load_trace(name: str) -> DropoutTrace:
    """Load a trace by its name in configs/dropouts, or by its file.

    Raises
    ------
    ConfigError
        Names the file, the line and what is allowed.
    """
    path = Path(name) if name.endswith(".csv") else FOLDER / f"{name}.csv"
    if path.is_file():
        return _load_csv(path)
    if not name.endswith((".yaml", ".yml")) and name not in part_names("dropouts"):
        known = ", ".join(trace_names())
        raise ConfigError(f"unknown dropout trace {name!r}: allowed are {known}, or the path of a .csv or .yaml file")
    file = fill(PatternFile, read_part("dropouts", name), name)
    tree = merge(read_part("radio", file.radio), file.radio_values)
    return DropoutTrace(Path(name).stem, file.description, fill(RadioConfig, tree, name, "radio."))


def write_csv(path: Path, deliveries: Deliveries, description: str) -> None:
    """Write recorded deliveries. Raises ConfigError if the file cannot be written."""
    rows = sorted(
        ((delivery, direction) for direction in DIRECTIONS for delivery in deliveries.get(direction, ())), key=_by_time
    )
    try:
        with path.open("w", encoding="utf-8", newline="") as file:
            file.write(f"# {description}\n")
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(COLUMNS)
            for delivery, direction in rows:
                delays = (_written(delivery.delay_ns), _written(delivery.copy_delay_ns))
                bit = delivery.flipped_bit if delivery.flipped_bit >= 0 else ""
                writer.writerow((direction, _written(max(delivery.sent_ns, 0)), delivery.outcome, *delays, bit))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}") from None


def _by_time(row: tuple[Delivery, Direction]) -> int:
    return row[0].sent_ns


def _written(time_ns: int) -> str:
    return f"{time_ns * 1e-6:.3f}".rstrip("0").rstrip(".") if time_ns >= 0 else ""


def _load_csv(path: Path) -> DropoutTrace:
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read: {error}") from None
    comments = [line.lstrip("# ") for line in lines if line.startswith("#")]
    numbered = [(number, line) for number, line in enumerate(lines, 1) if line and not line.startswith("#")]
    if not numbered or tuple(numbered[0][1].split(",")) != COLUMNS:
        raise ConfigError(f"{path}: expected the head {','.join(COLUMNS)}")
    deliveries: dict[Direction, list[Delivery]] = {direction: [] for direction in DIRECTIONS}
    for direction, delivery in _rows(path, numbered[1:]):
        before = deliveries[direction]
        if before and delivery.sent_ns < before[-1].sent_ns:
            raise ConfigError(f"{path}: {direction} at {delivery.sent_ns * 1e-6:.3f} ms: sent_ms decreases")
        before.append(delivery)
    return DropoutTrace(path.stem, " ".join(comments), RadioConfig(), deliveries)


def _rows(path: Path, numbered: list[tuple[int, str]]) -> Iterator[tuple[Direction, Delivery]]:
    for number, line in numbered:
        try:
            yield _row(line.split(","))
        except ValueError as error:
            raise ConfigError(f"{path}: line {number}: {line!r}: {error}") from None


def _row(cells: list[str]) -> tuple[Direction, Delivery]:
    if len(cells) != len(COLUMNS):
        raise ValueError(f"{len(cells)} cells, expected {len(COLUMNS)}")
    name, sent, outcome, delay, copy_delay, bit = cells
    direction = next((known for known in DIRECTIONS if known == name), None)
    if direction is None:
        raise ValueError(f"direction {name!r}, allowed are {', '.join(DIRECTIONS)}")
    if outcome not in OUTCOMES:
        raise ValueError(f"outcome {outcome!r}, allowed are {', '.join(OUTCOMES)}")
    if (outcome == "delivered") != bool(delay):
        raise ValueError("a delivered datagram needs a delay_ms, any other must have none")
    delivery = Delivery(_read(sent), SIZE_UNKNOWN, outcome, _read(delay), _read(copy_delay), int(bit) if bit else -1)
    return direction, delivery


def _read(text: str) -> int:
    if not text:
        return -1
    value = float(text)
    if not 0.0 <= value <= DELAY_MAX_MS:
        raise ValueError(f"{text} ms, allowed are 0 to {DELAY_MAX_MS:.0f}")
    return round(value * 1e6)
