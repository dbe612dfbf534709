"""`dmrac replay`: repeats a flight in lockstep with the deliveries of its link, or in a new core."""

import argparse
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from async_dmrac.commands.output import add_json_option, console_for, print_json
from async_dmrac.commands.shared import add_trust_option, plain_console
from configs.loader import ConfigError
from onboard.cores import CORES, PRECISIONS
from runtime.waiting import waiting

if TYPE_CHECKING:
    from experiments.replays.recorded_flight import RecordedFlight

EXAMPLES = """examples:
  dmrac replay flights/2026-01-01_120000_blackout                   the same flight again, in lockstep
  dmrac replay flights/... --controller pid                         another controller with the same link
  dmrac replay flights/... --check                                  does this onboard code give the same bits?
  dmrac replay flights/... --check --core c                         does the C core decide the same?
  dmrac replay flights/... --check --core c --precision float       and with numbers of 32 bits?
  dmrac replay flights/... --save-trace configs/dropouts/mine.csv   store the deliveries of its link for dmrac dropouts
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `dmrac replay`."""
    parser.add_argument("flight", type=Path, metavar="FLIGHT", help="folder of a recorded flight")
    parser.add_argument("--controller", metavar="NAME", help="fly with this controller instead of the recorded one")
    parser.add_argument("--seed", type=int, help="fly with this seed instead of the recorded one")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder of the new record (default: flights/...)")
    parser.add_argument(
        "--check", action="store_true", help="give onboard's logged inputs to a new core and compare all bits"
    )
    parser.add_argument(
        "--core",
        choices=CORES,
        help="with --check: the onboard core (default: the recorded one, which gives equal bits)",
    )
    parser.add_argument(
        "--precision", choices=PRECISIONS, default="double", help="with --core c: of its numbers (default: double)"
    )
    add_trust_option(parser)
    parser.add_argument("--key-file", type=Path, metavar="FILE", help="with --check: the key of the recorded link")
    add_json_option(parser, "the comparison")
    parser.add_argument(
        "--save-trace", type=Path, metavar="FILE", help="only write the link's deliveries to a .csv file"
    )


def run(arguments: argparse.Namespace) -> int:
    """Replay; return 0 (the vehicle survived, or the outputs agree) or 1 (it crashed, or they differ)."""
    from experiments.replays.recorded_flight import read_recorded

    if arguments.check and (arguments.controller or arguments.seed is not None):
        raise ConfigError("--check: compares with the recorded flight; it takes no --controller and no --seed")
    if arguments.core and not arguments.check:
        raise ConfigError(f"--core {arguments.core}: only with --check")
    if arguments.precision != "double" and arguments.core != "c":
        raise ConfigError(f"--precision {arguments.precision}: only with --core c")
    flight = read_recorded(arguments.flight, arguments.trust)
    if arguments.save_trace is not None:
        return save_trace(flight, arguments.save_trace)
    return check(flight, arguments) if arguments.check else replay(flight, arguments)


def replay(flight: "RecordedFlight", arguments: argparse.Namespace) -> int:
    """Fly with the recorded deliveries and print both flights side by side."""
    from experiments.flights.flight_folder import make_folder
    from experiments.flights.lockstep_status import LockstepStatus
    from experiments.replays.replay import comparison, figures, figures_of_recorded, refly, verdict, with_choices

    original = figures_of_recorded(flight)
    config = with_choices(flight.config, arguments.controller, arguments.seed)
    folder = make_folder(arguments.out, f"{config.scenario}_replay")
    with LockstepStatus(console_for(arguments), config.duration_s) as status:
        outcome = refly(flight, config, folder, (status,))
    again = figures(config, outcome.trace, outcome.crash_reason, outcome.deliveries)
    title = f"{config.scenario}, {config.controller}, seed {config.seed}, with the deliveries of {flight.path}"
    if arguments.json:
        print_json({"recorded": original, "replayed": again, "record": str(folder)})
        return 0 if again.survived else 1
    console_for(arguments).print(comparison(original, again, title))
    for line in (*verdict(flight, config, outcome), f"record: {folder}"):
        plain_console().print(line)
    return 0 if again.survived else 1


def check(flight: "RecordedFlight", arguments: argparse.Namespace) -> int:
    """Compare with the logged outputs; print the result of each onboard log."""
    from experiments.replays.replay_check import check_flight

    with waiting("giving the logged inputs to a new core"):
        results = check_flight(flight, arguments.key_file, arguments.core, arguments.precision)
    if arguments.json:
        print_json([{**asdict(result), "equal": result.equal} for result in results])
    else:
        for result in results:
            plain_console().print(str(result))
    return 0 if all(result.equal for result in results) else 1


def save_trace(flight: "RecordedFlight", path: Path) -> int:
    """Write the deliveries of the flight's link as a file for `dmrac dropouts`."""
    from experiments.link.dropout_trace import write_csv

    if path.suffix != ".csv":
        raise ConfigError(f"--save-trace {path}: expected a name that ends in .csv")
    if not any(flight.deliveries.values()):
        raise ConfigError(f"{flight.path}: holds no radio/delivery records")
    how = "in lockstep" if flight.lockstep else "in real time"
    about = f"Recorded {how}: {flight.config.scenario}, {flight.config.controller}, seed {flight.config.seed}."
    write_csv(path, flight.deliveries, about)
    plain_console().print(f"{sum(map(len, flight.deliveries.values()))} deliveries in {path}")
    return 0
