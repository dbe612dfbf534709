"""`dmrac fly`: one flight in real time over UDP or in lockstep, with its record and summary."""

import argparse
import json
import shlex
from contextlib import nullcontext
from pathlib import Path

from rich.console import Console

from configs.addresses import LINK_KEYS
from configs.loader import ConfigError
from experiments.flights.flight_folder import clear_folder, make_folder
from experiments.flights.flight_summary import print_summary
from experiments.flights.live_view import live_view, require_viewer
from experiments.flights.logged_flight import fly_logged
from experiments.flights.realtime_flight import FlightStartError, require_free_ports
from experiments.flights.scenario import DEFAULT_SCENARIO, Choices, FlightConfig, resolve
from experiments.memory.learning import remember
from offboard.memory.folder import memory_file
from onboard.cores import CORES, NUMPY, core_option
from protocol.keys import load_key

EXAMPLES = """examples:
  dmrac fly                                   the default scenario, figure8_wind, in real time
  dmrac fly rotor_chip --controller pid       the same fault with another controller
  dmrac fly figure8_wind --lockstep --seed 7  in virtual time: repeatable, several times faster
  dmrac fly figure8_wind --lockstep --core c  the same with the onboard core in C
  dmrac fly my_scenario.yaml --set onboard.guidance.look_ahead_s=0.1
  dmrac fly --view --web                      watch it in a browser while it flies (needs the viz extra)

exit status: 0 vehicle alive, 1 vehicle lost or the disk was full, 2 bad usage, 3 invalid flight (the simulator stood
still)
"""
EXIT_STATUS = {"alive": 0, "lost": 1, "invalid": 3}
"""By the outcome in summary.json."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `dmrac fly`."""
    parser.add_argument("scenario", nargs="?", default=DEFAULT_SCENARIO, help="name in configs/scenarios, or a file")
    parser.add_argument("--controller", help="name in configs/controllers, or a file")
    parser.add_argument("--seed", type=int, help="seed of all random values (default: the scenario's)")
    parser.add_argument("--duration", type=float, metavar="S", help="of the whole flight, s (default: the scenario's)")
    parser.add_argument("--lockstep", action="store_true", help="virtual time in one process instead of real time")
    parser.add_argument("--no-offboard", action="store_true", help="lockstep: fly without the offboard process")
    parser.add_argument("--core", choices=CORES, default=NUMPY, help=f"lockstep: the onboard core (default: {NUMPY})")
    parser.add_argument(
        "--no-log", action="store_true", help="lockstep: write config.yaml and summary.json only, no logs or figures"
    )
    parser.add_argument("--memory", type=Path, metavar="FOLDER", help="start from what earlier flights taught")
    parser.add_argument("--remember", action="store_true", help="with --memory: learn this flight into it afterwards")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder of the record (default: flights/...)")
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", dest="assignments", help="change a value by path"
    )
    parser.add_argument("--view", action="store_true", help="show the flight live in the 3-D viewer (real time only)")
    parser.add_argument("--web", action="store_true", help="with --view: serve it to a browser on this machine")


def run(arguments: argparse.Namespace) -> int:
    """Fly; return the exit status of the outcome. Raises ConfigError before anything is started."""
    memory = _memory_assignments(arguments)
    choices = Choices(arguments.controller, arguments.seed, arguments.duration, [*arguments.assignments, *memory])
    config = resolve(arguments.scenario, choices)
    if arguments.no_offboard and not arguments.lockstep:
        raise ConfigError("--no-offboard: only with --lockstep; in real time start the processes one by one")
    if arguments.core != NUMPY and not arguments.lockstep:
        raise ConfigError(f"--core {arguments.core}: only with --lockstep")
    if arguments.no_log and not arguments.lockstep:
        raise ConfigError("--no-log: only with --lockstep")
    if arguments.no_log and arguments.remember:
        raise ConfigError("--no-log: not with --remember, which learns from the log")
    if arguments.view and arguments.lockstep:
        raise ConfigError("--view: only in real time; show a lockstep flight afterwards with dmrac view")
    if arguments.web and not arguments.view:
        raise ConfigError("--web: only with --view")
    if arguments.view:
        require_viewer(arguments.web)
    network = config.network
    if not arguments.lockstep:
        require_free_ports(network)
    for key in LINK_KEYS.values():  # reports bad ones before the start
        load_key(getattr(network, key.setting))
    folder = make_folder(arguments.out, config.scenario)
    earlier = tuple(folder.iterdir())
    console = Console()
    try:
        with live_view(folder, arguments.web) if arguments.view else nullcontext() as wait_for_viewer:
            command = repeat_command(arguments, config)
            with_offboard, core, log = not arguments.no_offboard, arguments.core, not arguments.no_log
            summary = fly_logged(config, folder, arguments.lockstep, with_offboard, command, console, core, log)
            print_summary(summary, folder, console)
            if arguments.remember:
                console.print(f"memory          {remember(arguments.memory, folder)}", soft_wrap=True, highlight=False)
            if wait_for_viewer is not None:
                wait_for_viewer()
    except (FlightStartError, ConfigError) as error:
        raise type(error)(f"{error}{clear_folder(folder, earlier)}") from None
    return EXIT_STATUS[summary["outcome"]] or int(bool(summary["record_faults"]))


def _memory_assignments(arguments: argparse.Namespace) -> list[str]:
    """The setting that `--memory` stands for; none for a memory that `--remember` will begin. Raises ConfigError."""
    if arguments.remember and arguments.memory is None:
        raise ConfigError("--remember: only with --memory FOLDER")
    if arguments.memory is None or (arguments.remember and not memory_file(arguments.memory).exists()):
        return []
    return [f"offboard.experience.memory={json.dumps(str(arguments.memory))}"]


def _flags(arguments: argparse.Namespace) -> tuple[tuple[str, bool], ...]:
    """The options without a value, and whether they are given."""
    return (
        ("--lockstep", arguments.lockstep),
        ("--no-offboard", arguments.no_offboard),
        ("--no-log", arguments.no_log),
    )


def repeat_command(arguments: argparse.Namespace, config: FlightConfig) -> str:
    """Return the command that repeats this flight."""
    words = ["dmrac", "fly", arguments.scenario, "--controller", arguments.controller or config.controller]
    words += ["--seed", str(config.seed), "--duration", f"{config.duration_s:g}"]
    words += [flag for flag, on in _flags(arguments) if on]
    words += core_option(arguments.core)
    for assignment in [*arguments.assignments, *_memory_assignments(arguments)]:
        words += ["--set", assignment]
    return shlex.join(words)
