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
from mambo.vehicles import RADIO, VEHICLES
from offboard.memory.folder import memory_file
from onboard.cores import CORES
from protocol.keys import load_key

EXAMPLES = """examples:
  dmrac fly                                   the default scenario, figure8_wind, in real time
  dmrac fly rotor_chip --controller pid       the same fault with another controller
  dmrac fly figure8_wind --lockstep --seed 7  in virtual time: repeatable, several times faster
  dmrac fly figure8_wind --lockstep --core c  the same with the onboard core in C
  dmrac fly figure8_wind --vehicle mambo-qemu the drone's own library under qemu-arm, over Bluetooth's delays
  dmrac fly my_scenario.yaml --set onboard.guidance.look_ahead_s=0.1
  dmrac fly --view --web                      watch it in a browser while it flies (needs the viz extra)

exit status: 0 vehicle alive, 1 vehicle lost, 2 bad usage, 3 invalid flight (the simulator stood still)
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
    parser.add_argument("--core", choices=CORES, default="numpy", help="lockstep: the onboard core (default: numpy)")
    parser.add_argument(
        "--vehicle",
        choices=VEHICLES,
        help="lockstep, with the drone's library in a stand-in for its firmware: for its processor, or for this one",
    )
    parser.add_argument("--radio", metavar="NAME", help="name in configs/radio, or a file (default: the scenario's)")
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
    _choose_vehicle(arguments)
    choices = Choices(
        *(arguments.controller, arguments.seed, arguments.duration, [*arguments.assignments, *memory]),
        radio=arguments.radio,
    )
    config = resolve(arguments.scenario, choices)
    if arguments.no_offboard and not arguments.lockstep:
        raise ConfigError("--no-offboard: only with --lockstep; in real time start the processes one by one")
    if arguments.core != "numpy" and not arguments.lockstep:
        raise ConfigError(f"--core {arguments.core}: only with --lockstep")
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
            with_offboard, core = not arguments.no_offboard, arguments.core
            summary = fly_logged(config, folder, arguments.lockstep, with_offboard, command, console, core)
            print_summary(summary, folder, console)
            if arguments.remember:
                console.print(f"memory          {remember(arguments.memory, folder)}", soft_wrap=True, highlight=False)
            if wait_for_viewer is not None:
                wait_for_viewer()
    except (FlightStartError, ConfigError) as error:
        raise type(error)(f"{error}{clear_folder(folder, earlier)}") from None
    return EXIT_STATUS[summary["outcome"]]


def _memory_assignments(arguments: argparse.Namespace) -> list[str]:
    """The setting that `--memory` stands for; none for a memory that `--remember` will begin. Raises ConfigError."""
    if arguments.remember and arguments.memory is None:
        raise ConfigError("--remember: only with --memory FOLDER")
    if arguments.memory is None or (arguments.remember and not memory_file(arguments.memory).exists()):
        return []
    return [f"offboard.experience.memory={json.dumps(str(arguments.memory))}"]


def _choose_vehicle(arguments: argparse.Namespace) -> None:
    """With the drone's library: lockstep, and the delays of its radio. Raises ConfigError for a core of the laptop."""
    if arguments.vehicle is None:
        return
    if arguments.core != "numpy":
        raise ConfigError(f"--vehicle {arguments.vehicle}: not with --core; the library has its own")
    arguments.lockstep, arguments.core = True, arguments.vehicle
    arguments.radio = arguments.radio or RADIO


def repeat_command(arguments: argparse.Namespace, config: FlightConfig) -> str:
    """Return the command that repeats this flight."""
    words = ["dmrac", "fly", arguments.scenario, "--controller", arguments.controller or config.controller]
    words += ["--seed", str(config.seed), "--duration", f"{config.duration_s:g}"]
    words += [flag for flag, on in (("--lockstep", arguments.lockstep), ("--no-offboard", arguments.no_offboard)) if on]
    words += ["--core", arguments.core] if arguments.core in CORES[1:] else []
    words += ["--vehicle", arguments.vehicle] if arguments.vehicle else []
    words += ["--radio", arguments.radio] if arguments.radio else []
    for assignment in [*arguments.assignments, *_memory_assignments(arguments)]:
        words += ["--set", assignment]
    return shlex.join(words)
