"""`dmrac replay`: a flight once more, in lockstep with its link's deliveries, or through a fresh core bit for bit."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from configs.loader import ConfigError

if TYPE_CHECKING:
    from experiments.replays.recorded_flight import RecordedFlight

EXAMPLES = """examples:
  dmrac replay flights/2026-01-01_120000_blackout                   the same flight again, in lockstep
  dmrac replay flights/... --controller pid                         what another controller makes of that link
  dmrac replay flights/... --check                                  does this onboard code still give the same bits?
  dmrac replay flights/... --save-trace configs/dropouts/mine.csv   keep the deliveries of its link for dmrac dropouts
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `dmrac replay`."""
    parser.add_argument("flight", type=Path, metavar="FLIGHT", help="folder of a recorded flight")
    parser.add_argument("--controller", metavar="NAME", help="fly with this controller instead of the recorded one")
    parser.add_argument("--seed", type=int, help="fly with this seed instead of the recorded one")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder of the new record (default: flights/...)")
    parser.add_argument(
        "--check", action="store_true", help="feed onboard's logged inputs to a fresh core, compare bits"
    )
    parser.add_argument("--key-file", type=Path, metavar="FILE", help="with --check: the key of the recorded link")
    parser.add_argument(
        "--save-trace", type=Path, metavar="FILE", help="only write the link's deliveries to a .csv file"
    )


def run(arguments: argparse.Namespace) -> int:
    """Exit status: 0 flown again and alive (or equal), 1 vehicle lost (or different), 2 nothing was done."""
    from experiments.replays.recorded_flight import read_recorded

    if arguments.check and (arguments.controller or arguments.seed is not None):
        raise ConfigError("--check: compares with what was flown; it takes no --controller and no --seed")
    flight = read_recorded(arguments.flight)
    console = Console()
    if arguments.save_trace is not None:
        return save_trace(flight, arguments.save_trace, console)
    return check(flight, arguments.key_file, console) if arguments.check else replay(flight, arguments, console)


def replay(flight: "RecordedFlight", arguments: argparse.Namespace, console: Console) -> int:
    """Flies it again and shows both."""
    from experiments.flights.flight_folder import make_folder
    from experiments.flights.flight_summary import write_summary
    from experiments.flights.logged_flight import lockstep_summary
    from experiments.replays.replay import comparison, figures, figures_of_recorded, refly, verdict, with_choices

    original = figures_of_recorded(flight)
    config = with_choices(flight.config, arguments.controller, arguments.seed)
    folder = make_folder(arguments.out, f"{config.scenario}_replay")
    (folder / "config.yaml").write_text(config.to_yaml(), encoding="utf-8")
    outcome = refly(flight, config, folder)
    again = figures(config, outcome.trace, outcome.crash_reason, outcome.deliveries)
    write_summary(folder, lockstep_summary(config, outcome) | {"replay_of": str(flight.path.resolve())})
    title = f"{config.scenario}, {config.controller}, seed {config.seed}, with the deliveries of {flight.path}"
    console.print(comparison(original, again, title))
    for line in (*verdict(flight, config, outcome), f"record: {folder}"):
        console.print(line, highlight=False, soft_wrap=True)
    return 0 if again.survived else 1


def check(flight: "RecordedFlight", key_file: Path | None, console: Console) -> int:
    """Compares bit for bit; says how much was compared, or names the first difference."""
    from experiments.replays.replay_check import check_flight

    equal = True
    for result in check_flight(flight, key_file):
        said = f"{result.name}: {result.ticks} ticks, {result.datagrams_in} datagrams in, {result.datagrams_out} out"
        said += f", {result.failed_steps} failed steps" if result.failed_steps else ""
        if result.difference is not None:
            equal = False
            said += f"; FIRST DIFFERENCE: {result.difference}"
        else:
            said += f": equal bit for bit, {result.rows} tick records included"
        if result.incomplete:
            equal = False
            said += f"; NOT CHECKED further: {result.incomplete}"
        console.print(said, highlight=False, soft_wrap=True)
    return 0 if equal else 1


def save_trace(flight: "RecordedFlight", path: Path, console: Console) -> int:
    """Writes the deliveries of the flight's link as a file for `dmrac dropouts`."""
    from experiments.link.dropout_trace import write_csv

    if path.suffix != ".csv":
        raise ConfigError(f"--save-trace {path}: expected a name that ends in .csv")
    if not any(flight.deliveries.values()):
        raise ConfigError(f"{flight.path}: holds no radio/delivery records")
    how = "in lockstep" if flight.lockstep else "in real time"
    about = f"Recorded {how}: {flight.config.scenario}, {flight.config.controller}, seed {flight.config.seed}."
    write_csv(path, flight.deliveries, about)
    console.print(f"{sum(map(len, flight.deliveries.values()))} deliveries in {path}", highlight=False, soft_wrap=True)
    return 0
