"""`dmrac fly`: one flight in real time over UDP or in lockstep, with its record and summary."""

import argparse
import json
import shlex
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

from rich.console import Console

from async_dmrac.commands.output import add_json_option, console_for, print_json
from configs.addresses import LINK_KEYS
from configs.flight_tree import PORTS_EACH
from configs.loader import ConfigError
from experiments.flights.flight_folder import clear_folder, make_folder
from experiments.flights.flight_summary import print_summary
from experiments.flights.live_view import live_view, require_viewer
from experiments.flights.logged_flight import fly_logged
from experiments.flights.realtime_flight import FlightStartError, free_vehicle_number, require_free_ports
from experiments.flights.scenario import DEFAULT_SCENARIO, Choices, FlightConfig, resolve
from experiments.memory.learning import remember
from flight_log.viewer import WEB_PORT
from mambo.vehicles import RADIO, VEHICLES
from offboard.memory.folder import memory_file
from onboard.cores import CORES, NUMPY, core_option
from protocol.keys import load_key
from runtime.extras import require_modules
from runtime.sockets import AddressInUseError

EXAMPLES = """examples:
  dmrac fly                                   the default scenario, figure8_wind, in real time
  dmrac fly rotor_chip --controller pid       the same fault with another controller
  dmrac fly figure8_wind --lockstep --seed 7  in virtual time: repeatable, several times faster
  dmrac fly figure8_wind --lockstep --core c  the same with the onboard core in C
  dmrac fly figure8_wind --vehicle mambo-qemu the drone's own library under qemu-arm, over Bluetooth's delays
  dmrac fly my_scenario.yaml --set onboard.guidance.look_ahead_s=0.1
  dmrac fly --view --web                      watch it in a browser while it flies (needs the viz extra)
  dmrac fly --vehicle 2                       a second flight at the same time, with other ports
  dmrac fly hover --lockstep --json           the summary for a program; the live line goes to standard error

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
    parser.add_argument("--radio", metavar="NAME", help="name in configs/radio, or a file (default: the scenario's)")
    parser.add_argument("--memory", type=Path, metavar="FOLDER", help="start from what earlier flights taught")
    parser.add_argument("--remember", action="store_true", help="with --memory: learn this flight into it afterwards")
    parser.add_argument(
        "--vehicle",
        type=_vehicle,
        default=1,
        metavar="N|NAME",
        help=f"its number where several fly at once (default: 1): its id, and ports that are {PORTS_EACH} (N - 1) "
        f"higher; or the drone's own library, in lockstep in a stand-in for its firmware: {', '.join(VEHICLES)} (for "
        "its processor, for this one)",
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder of the record (default: flights/...)")
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", dest="assignments", help="change a value by path"
    )
    parser.add_argument("--view", action="store_true", help="show the flight live in the 3-D viewer (real time only)")
    parser.add_argument("--web", action="store_true", help="with --view: serve it to a browser on this machine")
    parser.add_argument(
        "--tensorboard", action="store_true", help="also write the training as a TensorBoard run, while it is flown"
    )
    add_json_option(parser, "summary.json")


def run(arguments: argparse.Namespace) -> int:
    """Fly; return the exit status of the outcome. Raises ConfigError before anything is started."""
    memory = _memory_assignments(arguments)
    library = _choose_library(arguments)
    assignments = [*arguments.assignments, *memory]
    number = 1 if library else arguments.vehicle
    choices = Choices(
        arguments.controller, arguments.seed, arguments.duration, assignments, vehicle=number, radio=arguments.radio
    )
    config = resolve(arguments.scenario, choices)
    _check_options(arguments)
    if arguments.view:
        require_viewer(arguments.web)
    learns = not arguments.no_offboard and config.offboard.experience.mode != "frozen"
    require_modules(*(() if arguments.no_log else ("matplotlib",)), *(("torch",) if learns else ()))
    if arguments.tensorboard:
        if arguments.no_log:
            raise ConfigError("--no-log: not with --tensorboard, which reads the log")
        require_modules("tensorboard", purpose="--tensorboard")
        if not learns:
            raise ConfigError(f"--tensorboard: {config.controller} trains nothing in this flight")
    network = config.network
    if not arguments.lockstep:
        _require_free_ports(arguments, choices)
    for key in LINK_KEYS.values():  # reports bad ones before the start
        load_key(getattr(network, key.setting))
    folder = make_folder(arguments.out, config.scenario)
    earlier = tuple(folder.iterdir())
    console = console_for(arguments)
    port = WEB_PORT + number - 1 if arguments.web else None
    try:
        with (
            live_view(folder, arguments.web, port) if arguments.view else nullcontext() as wait_for_viewer,
            _tensorboard(folder, console) if arguments.tensorboard else nullcontext(),
        ):
            command = repeat_command(arguments, config)
            with_offboard, core, log = not arguments.no_offboard, library or arguments.core, not arguments.no_log
            summary = fly_logged(config, folder, arguments.lockstep, with_offboard, command, console, core, log)
            if arguments.json:
                print_json({**summary, "record": str(folder)})
            else:
                print_summary(summary, folder, console)
            if arguments.remember:
                console.print(f"memory          {remember(arguments.memory, folder)}", soft_wrap=True, highlight=False)
            if wait_for_viewer is not None:
                wait_for_viewer()
    except (FlightStartError, ConfigError) as error:
        raise type(error)(f"{error}{clear_folder(folder, earlier)}") from None
    return EXIT_STATUS[summary["outcome"]] or int(bool(summary["record_faults"]))


def _check_options(arguments: argparse.Namespace) -> None:
    """Raise ConfigError for options that do not go together."""
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
    if arguments.view and arguments.json:
        raise ConfigError("--json: not with --view, which prints its address")
    if arguments.web and not arguments.view:
        raise ConfigError("--web: only with --view")


@contextmanager
def _tensorboard(folder: Path, console: Console) -> Iterator[None]:
    """Write the training into the record while the flight goes on, and print where it is."""
    from flight_log.tensorboard import live_tensorboard

    run = folder / "tensorboard"
    with live_tensorboard(folder, run) as follower:
        console.print(f"tensorboard --logdir {shlex.quote(str(run))}", soft_wrap=True, highlight=False, markup=False)
        yield
    if follower.run is None:
        console.print("tensorboard     nothing was trained in this flight", soft_wrap=True, highlight=False)


def _require_free_ports(arguments: argparse.Namespace, choices: Choices) -> None:
    """Raise AddressInUseError if an address is in use; names the number of a vehicle whose addresses are free."""
    try:
        require_free_ports(resolve(arguments.scenario, choices).network)
    except AddressInUseError as error:
        free = free_vehicle_number(arguments.scenario, choices)
        hint = "" if free is None else f"; or fly beside it with --vehicle {free}"
        raise AddressInUseError(f"{error}{hint}") from None


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


def _vehicle(text: str) -> int | str:
    """The value of `--vehicle`: a number, or a name of VEHICLES."""
    if text in VEHICLES:
        return text
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r}: allowed are a number, {', '.join(VEHICLES)}") from None


def _choose_library(arguments: argparse.Namespace) -> str | None:
    """The drone's library, if it flies: in lockstep, over its radio's delays. Raises ConfigError for --core."""
    if arguments.vehicle not in VEHICLES:
        return None
    if arguments.core != NUMPY:
        raise ConfigError(f"--vehicle {arguments.vehicle}: not with --core; the library has its own")
    arguments.lockstep, arguments.radio = True, arguments.radio or RADIO
    return str(arguments.vehicle)


def repeat_command(arguments: argparse.Namespace, config: FlightConfig) -> str:
    """Return the command that repeats this flight."""
    words = ["dmrac", "fly", arguments.scenario, "--controller", arguments.controller or config.controller]
    words += ["--seed", str(config.seed), "--duration", f"{config.duration_s:g}"]
    words += [flag for flag, on in _flags(arguments) if on]
    words += core_option(arguments.core)
    words += ["--vehicle", str(arguments.vehicle)] if arguments.vehicle != 1 else []
    words += ["--radio", arguments.radio] if arguments.radio else []
    for assignment in [*arguments.assignments, *_memory_assignments(arguments)]:
        words += ["--set", assignment]
    return shlex.join(words)
