"""`dmrac fly`: a whole flight, in real time over UDP or in lockstep, with its record and flight card."""

import argparse
import shlex
from collections import Counter
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from configs.loader import ConfigError
from experiments.flights.flight_card import build_summary, print_card, write_summary
from experiments.flights.flight_folder import clear_folder, make_folder
from experiments.flights.live_view import live_view
from experiments.flights.realtime_flight import FlightStartError, require_free_ports
from experiments.flights.scenario import DEFAULT_SCENARIO, Choices, FlightConfig, resolve
from experiments.flights.trace import FlightTrace
from protocol.keys import load_keys

Array = NDArray[np.float64]

if TYPE_CHECKING:
    from experiments.flights.lockstep_flight import LockstepOutcome

EXAMPLES = """examples:
  dmrac fly                                   the default scenario, figure8_wind, in real time
  dmrac fly rotor_chip --controller pid       the same fault with another controller
  dmrac fly figure8_wind --lockstep --seed 7  in virtual time: repeatable, several times faster
  dmrac fly my_scenario.yaml --set onboard.guidance.look_ahead_s=0.1
  dmrac fly --view --web                      watch it in a browser while it flies (needs the viz extra)
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `dmrac fly`."""
    parser.add_argument("scenario", nargs="?", default=DEFAULT_SCENARIO, help="name in configs/scenarios, or a file")
    parser.add_argument("--controller", help="name in configs/controllers, or a file")
    parser.add_argument("--seed", type=int, help="of everything random (default: the scenario's)")
    parser.add_argument("--duration", type=float, metavar="S", help="s, the whole flight (default: the scenario's)")
    parser.add_argument("--lockstep", action="store_true", help="virtual time in one process instead of real time")
    parser.add_argument("--no-offboard", action="store_true", help="lockstep: fly without the offboard process")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder of the record (default: flights/...)")
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", dest="assignments", help="overrule a value by path"
    )
    parser.add_argument("--view", action="store_true", help="show the flight live in the 3-D viewer (real time only)")
    parser.add_argument("--web", action="store_true", help="with --view: serve it to a browser on this machine")


def run(arguments: argparse.Namespace) -> int:
    """Flies; returns 0 (vehicle alive), 1 (vehicle lost) or 2 (nothing was started)."""
    choices = Choices(arguments.controller, arguments.seed, arguments.duration, arguments.assignments)
    config = resolve(arguments.scenario, choices)
    if arguments.no_offboard and not arguments.lockstep:
        raise ConfigError("--no-offboard: only with --lockstep; in real time start the processes one by one")
    if arguments.view and arguments.lockstep:
        raise ConfigError("--view: only in real time; a lockstep flight is shown afterwards with dmrac view")
    if arguments.web and not arguments.view:
        raise ConfigError("--web: only with --view")
    if arguments.view:
        _require_viewer(arguments.web)
    if not arguments.lockstep:
        require_free_ports(config.network)
    network = config.network
    load_keys(network.key_file, network.vehicle_key_file, network.ground_key_file)  # bad ones are said before the start
    folder = make_folder(arguments.out, config.scenario)
    kept = tuple(folder.iterdir())
    try:
        with live_view(folder, arguments.web) if arguments.view else nullcontext() as watch:
            summary = _fly(arguments, config, folder)
            if watch is not None:
                watch()
    except (FlightStartError, ConfigError) as error:
        raise type(error)(f"{error}{clear_folder(folder, kept)}") from None
    return 0 if summary["survived"] else 1


def _fly(arguments: argparse.Namespace, config: FlightConfig, folder: Path) -> dict[str, Any]:
    """The flight with its record; what summary.json says. Raises FlightStartError, or ConfigError."""
    (folder / "config.yaml").write_text(config.to_yaml(), encoding="utf-8")
    console = Console()
    trace: FlightTrace | None
    if arguments.lockstep:
        summary, trace = fly_in_lockstep(config, folder, not arguments.no_offboard)
    else:
        summary, trace = fly_in_real_time(config, folder, console)
    summary["command"] = repeat_command(arguments, config)
    write_summary(folder, summary)
    if trace is not None:
        from experiments.flights.flight_figure import draw_flight
        from flight_record.report import write_report

        title = f"{config.scenario}, {config.controller}, seed {config.seed}, {summary['mode']}"
        draw_flight(trace, title, folder / "flight.png", lost_datagrams(folder))
        write_report(folder)
    print_card(summary, folder, console)
    return summary


def _require_viewer(web: bool) -> None:
    """Raises ConfigError if there is nothing to show the flight with."""
    from flight_record.viewer import ViewerError, require_screen, viewer_binary

    try:
        viewer_binary()
        if not web:
            require_screen()
    except ViewerError as error:
        raise ConfigError(f"--view: {error}") from None


def repeat_command(arguments: argparse.Namespace, config: FlightConfig) -> str:
    """The command line that flies this flight again."""
    words = ["dmrac", "fly", arguments.scenario, "--controller", arguments.controller or config.controller]
    words += ["--seed", str(config.seed), "--duration", f"{config.duration_s:g}"]
    words += [flag for flag, on in (("--lockstep", arguments.lockstep), ("--no-offboard", arguments.no_offboard)) if on]
    for assignment in arguments.assignments:
        words += ["--set", assignment]
    return shlex.join(words)


def fly_in_lockstep(config: FlightConfig, folder: Path, with_offboard: bool) -> tuple[dict[str, Any], FlightTrace]:
    """One flight in virtual time, logged like a real one."""
    from experiments.flights.lockstep_flight import fly_lockstep
    from experiments.flights.lockstep_log import LockstepLog

    with LockstepLog(folder, config, with_offboard) as log:
        outcome = fly_lockstep(config, (log,), with_offboard)
        for when_ns, process, text in outcome.events:
            log.event(process, when_ns, text)
    return lockstep_summary(config, outcome), outcome.trace


def lockstep_summary(config: FlightConfig, outcome: "LockstepOutcome") -> dict[str, Any]:
    """summary.json of a flight in virtual time."""
    rejected = Counter(outcome.onboard["rejected"])
    rejected.update((outcome.offboard or {}).get("rejected", {}))
    onboard = outcome.onboard
    summary = build_summary(
        config, "lockstep", outcome.trace, outcome.crash_reason, onboard, outcome.radio, dict(rejected)
    )
    summary["trace_sha256"] = outcome.trace_sha256
    return summary


def fly_in_real_time(config: FlightConfig, folder: Path, console: Console) -> tuple[dict[str, Any], FlightTrace | None]:
    """One flight in three processes over UDP."""
    from experiments.flights.live_status import LiveStatus
    from experiments.flights.metrics import lost_target
    from experiments.flights.realtime_flight import run as fly_processes

    with LiveStatus(console) as status:
        result = fly_processes(config.network, folder / "config.yaml", config.duration_s, folder, status)
    trace = read_trace(folder)
    onboard = result.onboard or {}
    sim = result.sim or {}
    crash = sim.get("crash_reason", "the simulated vehicle left no summary")
    crash = crash or (lost_target(trace) if trace is not None else "no log of the flight")
    if result.onboard is None:
        crash = crash or "onboard ended in flight"
    rejected = Counter(onboard.get("rejected", {}))
    rejected.update((result.offboard or {}).get("rejected", {}))
    radio = {
        direction: {name: counts[name] for name in ("sent", "delivered", "lost")}
        for direction, counts in sim.get("link", {}).items()
    }
    summary = build_summary(config, "realtime", trace, crash, onboard, radio, dict(rejected))
    summary["interrupted"] = result.interrupted
    summary["notes"] = result.notes
    return summary, trace


def read_trace(folder: Path) -> FlightTrace | None:
    """The trace of a recorded flight; None if a log is missing or empty."""
    from experiments.flights.trace import trace_of
    from flight_record.reader import FlightError, open_flight

    try:
        return trace_of(open_flight(folder))
    except FlightError:
        return None


def lost_datagrams(folder: Path) -> dict[str, Array]:
    """Seconds from onboard's first tick at which datagrams were lost, by direction; empty without a log of them."""
    from flight_record.reader import FlightError, open_flight
    from sim_vehicle.radio import DIRECTIONS, OUTCOMES

    try:
        flight = open_flight(folder)
    except FlightError:
        return {}
    tick, fate = flight.get("onboard/tick"), flight.get("radio/fate")
    if tick is None or fate is None or len(tick) == 0:
        return {}
    lost = fate["outcome"] != OUTCOMES.index("delivered")
    seconds = (fate.time_ns - tick.time_ns[0]) * 1e-9
    return {name: seconds[lost & (fate["direction"] == number)] for number, name in enumerate(DIRECTIONS)}
