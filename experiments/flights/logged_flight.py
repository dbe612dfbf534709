"""Flies once and writes the record: logs, summary, figure and report, in lockstep or in real time."""

from pathlib import Path
from typing import Any

from rich.console import Console

from experiments.flights.flight_summary import build_summary, write_summary
from experiments.flights.lockstep_flight import LockstepOutcome, fly_lockstep
from experiments.flights.scenario import FlightConfig, with_pose_wait
from experiments.flights.trace import FlightTrace
from onboard.cores import NUMPY
from protocol.conventions import Array
from runtime.files import no_space
from runtime.waiting import waiting


def fly_logged(
    config: FlightConfig,
    folder: Path,
    lockstep: bool,
    with_offboard: bool = True,
    command: str = "",
    console: Console | None = None,
    core: str = NUMPY,
    log: bool = True,
) -> dict[str, Any]:
    """Fly once and write the complete record into `folder`; return the content of summary.json.

    A full disk does not end the flight; "record_faults" of the summary then says what the record lacks.

    Parameters
    ----------
    command: the command line that repeats this flight, for the record.
    console: shows the live status of the flight; None: no output.
    core: the onboard core of a lockstep flight, one of onboard.cores.CORES.
    log: whether a lockstep flight writes logs, figure and report; without them config.yaml and summary.json are left.

    Raises
    ------
    FlightStartError
        If a process of a real-time flight does not start.
    ConfigError
        If the configuration does not fit, for example an experience of another controller.
    """
    console = console or Console(quiet=True)
    config = config if with_offboard else with_pose_wait(config)
    (folder / "config.yaml").write_text(config.to_yaml(), encoding="utf-8")
    trace: FlightTrace | None
    if lockstep:
        outcome = fly_in_lockstep(config, folder if log else None, with_offboard, core, console)
        summary, trace = lockstep_summary(config, outcome), outcome.trace if log else None
    else:
        summary, trace = fly_in_real_time(config, folder, console)
    summary["command"] = command
    try:
        write_summary(folder, summary)
        if trace is not None:
            with waiting("writing figure and report", console):
                _draw(config, folder, summary, trace)
    except OSError as error:
        if not no_space(error):
            raise
        summary["record_faults"].append(f"{error.filename or folder}: {error.strerror}")
    return summary


def fly_in_lockstep(
    config: FlightConfig, folder: Path | None, with_offboard: bool, core: str, console: Console
) -> LockstepOutcome:
    """Fly in virtual time, the trainer in a process of its own; the logs into `folder`, if there is one."""
    from experiments.flights.lockstep_log import fly_and_log
    from experiments.flights.lockstep_status import LockstepStatus
    from experiments.flights.training_worker import training_for

    with training_for(config if with_offboard else None) as train, LockstepStatus(console, config.duration_s) as status:
        if folder is None:
            return fly_lockstep(config, (status,), with_offboard, core=core, train=train)
        return fly_and_log(config, folder, with_offboard, core=core, train=train, observers=(status,))


def _draw(config: FlightConfig, folder: Path, summary: dict[str, Any], trace: FlightTrace) -> None:
    """Draw the figure and write the report. Raises OSError."""
    from experiments.flights.flight_figure import draw_flight
    from flight_log.report import write_report

    title = f"{config.scenario}, {config.controller}, seed {config.seed}, {summary['mode']}"
    draw_flight(trace, title, folder / "flight.png", lost_datagrams(folder))
    write_report(folder)


def lockstep_summary(config: FlightConfig, outcome: LockstepOutcome) -> dict[str, Any]:
    """Return the content of summary.json of a flight in virtual time."""
    sides = outcome.onboard, outcome.offboard, outcome.radio
    summary = build_summary(config, "lockstep", outcome.trace, outcome.crash_reason, *sides)
    summary["trace_sha256"] = outcome.trace_sha256
    summary["record_faults"] = outcome.log_faults
    return summary


def fly_in_real_time(config: FlightConfig, folder: Path, console: Console) -> tuple[dict[str, Any], FlightTrace | None]:
    """Fly in real time, with three processes over UDP."""
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
    radio = {
        direction: {name: counts[name] for name in ("sent", "delivered", "lost")}
        for direction, counts in sim.get("link", {}).items()
    }
    summary = build_summary(
        config, "realtime", trace, crash, onboard, result.offboard, radio, sim.get("invalid_reason", "")
    )
    summary["interrupted"] = result.interrupted
    summary["notes"] = result.notes
    summary["record_faults"] = result.faults
    return summary, trace


def read_trace(folder: Path) -> FlightTrace | None:
    """Return the trace of a recorded flight; None if a log is missing or empty."""
    from experiments.flights.trace import trace_of
    from flight_log.reader import FlightError, open_flight

    try:
        return trace_of(open_flight(folder))
    except FlightError:
        return None


def lost_datagrams(folder: Path) -> dict[str, Array]:
    """Return the times of lost datagrams, s from onboard's first tick, by direction; empty if they were not logged."""
    from flight_log.reader import FlightError, open_flight
    from sim_vehicle.link.radio import DIRECTIONS, OUTCOMES

    try:
        flight = open_flight(folder)
    except FlightError:
        return {}
    tick, delivery = flight.get("onboard/tick"), flight.get("radio/delivery")
    if tick is None or delivery is None or len(tick) == 0:
        return {}
    lost = delivery["outcome"] != OUTCOMES.index("delivered")
    seconds = (delivery.time_ns - tick.time_ns[0]) * 1e-9
    return {name: seconds[lost & (delivery["direction"] == number)] for number, name in enumerate(DIRECTIONS)}
