"""Whole flights of numpy's core given to the C core, in double and in float: one table over scenarios and controllers.

    python -m experiments.replays.core_parity [--scenarios NAME ...] [--controllers NAME ...] [--seconds S]
                                              [--keep FOLDER] [--json FILE]

Each flight is what these two commands do: `dmrac fly --lockstep`, then `dmrac replay --check --core c`, once in each
precision. It needs a C compiler.
"""

import argparse
import json
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

from configs.loader import ConfigError
from experiments.flights.lockstep_log import fly_and_log
from experiments.flights.scenario import Choices, resolve
from experiments.replays.judges import MOTOR_DIFFERENCE_MAX
from experiments.replays.recorded_flight import RecordedFlight, read_recorded
from experiments.replays.replay_check import check_flight
from onboard.cores import PRECISIONS
from onboard.record.tick import OFFSET, TICK

SCENARIOS: Final[dict[str, tuple[str, tuple[str, ...]]]] = {
    "jet": ("figure8_wind", ()),
    "dropouts": (
        "figure8_real",
        (
            "radio.both.burst={enter: 0.05, leave: 0.15}",
            "radio.both.duplication=0.01",
            "radio.both.reordering=0.02",
            "radio.both.corruption=0.01",
        ),
    ),
    "blackout": ("blackout", ()),
    "chip": ("rotor_chip", ()),
    "cloth": ("cloth_circle", ()),
}
"""By short name: a scenario of configs/scenarios, and what is set over it. The dropouts are those of configs/radio/bad,
with the other vehicle."""
CONTROLLERS: Final = ("none", "pid", "bias", "mrac", "dmrac", "l1", "indi", "repetitive", "ilc")
SECONDS: Final = 60.0
SEED: Final = 3


@dataclass(frozen=True)
class ParityRow:
    """One flight through the C core in one precision."""

    scenario: str
    controller: str
    precision: str
    ticks: int
    """Compared, up to the first difference."""
    events: int
    """Of the flight's onboard log."""
    versions: int
    """Newest feature version of the flight."""
    motor_difference: float
    """Largest of a motor command, as a share of the maximum thrust."""
    finding: str
    """The first difference that is not allowed; "" for none."""

    @property
    def cells(self) -> tuple[str, ...]:
        """For a table."""
        finding = self.finding or "same decisions"
        numbers = f"{self.ticks}", f"{self.events}", f"{self.versions}", f"{self.motor_difference:.1e}"
        return self.scenario, self.controller, self.precision, *numbers, finding


HEADINGS: Final = ("scenario", "controller", "numbers", "ticks", "events", "version", "motors differ by", "found")


def fly_with_numpy(scenario: str, controller: str, seconds: float, folder: Path) -> RecordedFlight:
    """Fly with numpy's core and record it in `folder`; a flight that is there already is not flown again.

    Raises
    ------
    ConfigError
        If there is no such controller, or the folder holds another flight.
    """
    name, assignments = SCENARIOS[scenario]
    config = resolve(name, Choices(controller, SEED, seconds, assignments))
    if not folder.exists():
        part = folder.with_name(f"{folder.name}.part")
        part.mkdir(parents=True)
        fly_and_log(config, part, with_offboard=True)
        part.rename(folder)
    flight = read_recorded(folder)
    if flight.config != config:
        raise ConfigError(f"{folder}: holds another flight than {scenario} with {controller}, {seconds:g} s")
    return flight


def compare_flight(scenario: str, controller: str, seconds: float, folder: Path) -> Iterator[ParityRow]:
    """Fly once with numpy's core and give the flight to the C core, in each precision.

    folder: of the flight's record (`fly_with_numpy`).

    Raises
    ------
    ConfigError
        If there is no such scenario in SCENARIOS or no such controller, or the C core cannot be built.
    """
    if scenario not in SCENARIOS:
        raise ConfigError(f"scenario {scenario!r}: allowed are {', '.join(SCENARIOS)}")
    flight = fly_with_numpy(scenario, controller, seconds, folder)
    (log,) = flight.onboard_logs
    events = sum(map(len, log.texts.values()))
    versions = int(log.vectors[TICK.topic].values[:, OFFSET["feature_version"]].max())
    for precision in PRECISIONS:
        (result,) = check_flight(flight, core="c", precision=precision)
        finding = "" if result.equal else str(result.difference or result.incomplete)
        yield ParityRow(
            scenario, controller, precision, result.ticks, events, versions, result.motor_difference, finding
        )


def main(words: Sequence[str] | None = None) -> int:
    """Print a row after each flight; return 0, or 1 if a core decides or commands otherwise."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenarios", nargs="+", default=list(SCENARIOS), metavar="NAME")
    parser.add_argument("--controllers", nargs="+", default=list(CONTROLLERS), metavar="NAME")
    parser.add_argument("--seconds", type=float, default=SECONDS, help="of each flight (default: %(default)g)")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="keep the flights here, and use those that are")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the rows to this file")
    arguments = parser.parse_args(words)
    rows: list[ParityRow] = []
    print(f"| {' | '.join(HEADINGS)} |\n|{'---|' * len(HEADINGS)}")
    with tempfile.TemporaryDirectory() as temporary:
        base = arguments.keep or Path(temporary)
        for scenario in arguments.scenarios:
            for controller in arguments.controllers:
                folder = base / f"{scenario}_{controller}"
                for row in compare_flight(scenario, controller, arguments.seconds, folder):
                    rows.append(row)
                    print(f"| {' | '.join(row.cells)} |", flush=True)
    for precision in PRECISIONS:
        largest = max(row.motor_difference for row in rows if row.precision == precision)
        different = sum(bool(row.finding) for row in rows if row.precision == precision)
        allowed = MOTOR_DIFFERENCE_MAX[precision]
        print(f"{precision}: motors within {largest:.1e} ({allowed:.0e} allowed), {different} flights differ")
    if arguments.json is not None:
        arguments.json.write_text(json.dumps([asdict(row) for row in rows], indent=2) + "\n", encoding="utf-8")
    return int(any(row.finding for row in rows))


if __name__ == "__main__":
    try:
        sys.exit(main())
    except ConfigError as error:
        sys.exit(f"core_parity: {error}")
