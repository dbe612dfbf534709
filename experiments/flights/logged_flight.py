"""One whole flight with its record: logs, summary, picture and report, in lockstep or in real time."""

from collections import Counter
from pathlib import Path
from typing import Any

from rich.console import Console

from experiments.flights.flight_summary import build_summary, write_summary
from experiments.flights.lockstep_flight import LockstepOutcome
from experiments.flights.scenario import FlightConfig
from experiments.flights.trace import FlightTrace
from protocol.conventions import Array


def fly_logged(
    config: FlightConfig,
    folder: Path,
    lockstep: bool,
    with_offboard: bool = True,
    command: str = "",
    console: Console | None = None,
) -> dict[str, Any]:
    """Fly once and leave the whole record in `folder`; returns what its summary.json holds.

    Parameters
    ----------
    command: the command line that repeats this flight, for the record.
    console: where the live status of a real-time flight goes; None: nowhere.

    Raises
    ------
    FlightStartError
        If a process of a real-time flight does not start.
    ConfigError
        If the configuration does not fit, for example an experience of another controller.
    """
    from experiments.flights.flight_figure import draw_flight
    from flight_log.report import write_report

    (folder / "config.yaml").write_text(config.to_yaml(), encoding="utf-8")
    trace: FlightTrace | None
    if lockstep:
        summary, trace = fly_in_lockstep(config, folder, with_offboard)
    else:
        summary, trace = fly_in_real_time(config, folder, console or Console(quiet=True))
    summary["command"] = command
    write_summary(folder, summary)
    if trace is not None:
        title = f"{config.scenario}, {config.controller}, seed {config.seed}, {summary['mode']}"
        draw_flight(trace, title, folder / "flight.png", lost_datagrams(folder))
        write_report(folder)
    return summary


def fly_in_lockstep(config: FlightConfig, folder: Path, with_offboard: bool) -> tuple[dict[str, Any], FlightTrace]:
    """One flight in virtual time, logged like a real one."""
    from experiments.flights.lockstep_flight import fly_lockstep
    from experiments.flights.lockstep_log import LockstepLog

    with LockstepLog(folder, config, with_offboard) as log:
        outcome = fly_lockstep(config, (log,), with_offboard)
        for when_ns, process, text in outcome.events:
            log.event(process, when_ns, text)
    return lockstep_summary(config, outcome), outcome.trace


def lockstep_summary(config: FlightConfig, outcome: LockstepOutcome) -> dict[str, Any]:
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
    from flight_log.reader import FlightError, open_flight

    try:
        return trace_of(open_flight(folder))
    except FlightError:
        return None


def lost_datagrams(folder: Path) -> dict[str, Array]:
    """Seconds from onboard's first tick at which datagrams were lost, by direction; empty without a log of them."""
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
