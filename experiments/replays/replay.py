"""Replays a recorded flight in lockstep, with the recorded deliveries of its link, and compares the two flights."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from rich.table import Table

from configs.flight_tree import read_law
from configs.loader import CONFIG_DIRECTORY, ConfigError, merge, read_tree
from configs.parts import named_file, read_part
from experiments.flights.carried_experience import learns
from experiments.flights.flight_summary import write_summary
from experiments.flights.lockstep_flight import Deliveries, LockstepOutcome, Observer
from experiments.flights.lockstep_log import fly_and_log
from experiments.flights.logged_flight import lockstep_summary
from experiments.flights.metrics import flight_metrics, known_ages, lost_target, median
from experiments.flights.scenario import FlightConfig, complete, fill_flight
from experiments.flights.trace import FlightTrace
from experiments.replays.link_quality import LinkQuality, link_quality
from experiments.replays.recorded_flight import RecordedFlight
from sim_vehicle.link.radio import DIRECTIONS, Direction

NOTHING: Final = "-"
SEED_MAX: Final = 2**31 - 1


@dataclass(frozen=True)
class FlightFigures:
    """Figures by which two flights are compared."""

    survived: bool
    crash_reason: str
    flown_s: float
    position_rmse_m: float
    settled_rmse_m: float
    feature_age_median_s: float
    """Of the trained features, on the path; NaN if only the start features were used."""
    feature_version: int
    link: dict[Direction, LinkQuality]


def figures(config: FlightConfig, trace: FlightTrace, crash_reason: str, deliveries: Deliveries) -> FlightFigures:
    """Return the figures of a flight."""
    metrics = flight_metrics(trace, config.onboard.guidance.trajectory)
    flown_s = float(trace.time_s[-1])
    return FlightFigures(
        survived=not crash_reason,
        crash_reason=crash_reason,
        flown_s=flown_s,
        position_rmse_m=metrics.position_rmse_m,
        settled_rmse_m=metrics.settled_rmse_m,
        feature_age_median_s=median(known_ages(trace, "feature_age")),
        feature_version=int(trace.tick["feature_version"][-1]),
        link={direction: link_quality(deliveries.get(direction, ()), flown_s) for direction in DIRECTIONS},
    )


def figures_of_recorded(flight: RecordedFlight) -> FlightFigures:
    """Return the figures of the recorded flight. Raises ConfigError if a log is missing."""
    if flight.trace is None:
        raise ConfigError(f"{flight.path}: the logs of onboard and vehicle are needed, and one is missing or empty")
    crash = flight.summary.get("crash_reason", "") or lost_target(flight.trace)
    return figures(flight.config, flight.trace, crash, flight.deliveries)


def with_choices(config: FlightConfig, controller: str | None, seed: int | None) -> FlightConfig:
    """Return the flight's configuration with another controller or seed.

    Raises
    ------
    ConfigError
        If there is no such controller, or the seed is out of range.
    """
    if controller is None and seed is None:
        return config
    tree: dict[str, Any] = config.model_dump(mode="json", by_alias=True)
    if seed is not None:
        if not 0 <= seed <= SEED_MAX:
            raise ConfigError(f"--seed {seed}: allowed are 0 to {SEED_MAX}")
        tree["seed"] = tree["onboard"]["seed"] = tree["offboard"]["seed"] = seed
    if controller is None:
        return fill_flight(tree, f"--seed {seed}")
    law = read_law(controller)
    leads = law.pop("guidance", {})
    untrained = read_tree(CONFIG_DIRECTORY / "features.yaml")["untrained"]
    tree["features"] = merge({**tree["features"], "untrained": untrained}, law.pop("features", {}))
    tree["controller"], tree["onboard"]["controller"] = controller, law
    tree["onboard"]["guidance"] = merge(merge(tree["onboard"]["guidance"], _former_leads(config)), leads)
    recorded = config.onboard.controller.build(config.onboard.airframe, config.features, config.seed)
    if not learns(recorded):  # it trained nothing, so its configuration of the experience means nothing
        tree["offboard"].pop("experience")
    return complete(tree, str(named_file("controllers", controller)))


def _former_leads(config: FlightConfig) -> dict[str, Any]:
    """Return the default values of the lead times that the recorded controller had set."""
    try:
        brought = read_part("controllers", config.controller).get("guidance", {})
    except ConfigError:
        return {}
    usual = read_tree(CONFIG_DIRECTORY / "guidance.yaml")
    return {key: usual[key] for key in brought if key in usual}


def refly(
    flight: RecordedFlight, config: FlightConfig, folder: Path, observers: tuple[Observer, ...] = ()
) -> LockstepOutcome:
    """Fly `config` in lockstep with the recorded deliveries; write configuration, logs and summary into `folder`.

    Raises
    ------
    ConfigError
        If the flight has no recorded deliveries.
    """
    if not any(flight.deliveries.values()):
        raise ConfigError(f"{flight.path}: holds no radio/delivery records, so there are no deliveries to fly again")
    (folder / "config.yaml").write_text(config.to_yaml(), encoding="utf-8")
    recorded = flight.with_offboard, flight.experience, flight.deliveries, flight.core
    outcome = fly_and_log(config, folder, *recorded, observers=observers)
    write_summary(folder, lockstep_summary(config, outcome) | {"replay_of": str(flight.path.resolve())})
    return outcome


def verdict(flight: RecordedFlight, config: FlightConfig, outcome: LockstepOutcome) -> list[str]:
    """Return lines that tell how faithful the replay was."""
    lines = []
    for direction, recording in outcome.recordings.items():
        extra = len(outcome.deliveries[direction]) - recording.used - recording.repeated
        line = f"{direction}: {recording.used} of {len(flight.deliveries[direction])} recorded deliveries used"
        line += f", {recording.skipped} skipped" if recording.skipped else ""
        line += f", {recording.repeated} datagrams shared one" if recording.repeated else ""
        line += f", {extra} sent after the end of the record" if extra else ""
        lines.append(line)
    same = flight.lockstep and config == flight.config
    if same and "trace_sha256" in flight.summary:
        equal = flight.summary["trace_sha256"] == outcome.trace_sha256
        lines.append(
            "the same trace hash: the flights are equal bit for bit"
            if equal
            else "another trace hash: the code has changed since the recorded flight"
        )
    return lines


def comparison(original: FlightFigures, replay: FlightFigures, title: str) -> Table:
    """Return a table of both flights, side by side."""
    table = Table(title=title, title_justify="left")
    for heading in ("", "original", "replay"):
        table.add_column(heading, justify="left" if not heading else "right")
    for row in rows(original, replay):
        table.add_row(*row)
    return table


def rows(*flights: FlightFigures) -> list[tuple[str, ...]]:
    """Return one row for each figure, with one column for each flight."""
    lines: list[tuple[str, ...]] = [
        ("survived", *("yes" if flight.survived else f"no: {flight.crash_reason}" for flight in flights)),
        ("flown", *(f"{flight.flown_s:.2f} s" for flight in flights)),
        ("position RMSE", *(_number(flight.position_rmse_m, "m") for flight in flights)),
        ("settled RMSE", *(_number(flight.settled_rmse_m, "m") for flight in flights)),
        ("feature age, median", *(_number(flight.feature_age_median_s, "s", 2) for flight in flights)),
        ("last feature version", *(str(flight.feature_version) for flight in flights)),
    ]
    for direction in DIRECTIONS:
        links = [flight.link[direction] for flight in flights]
        lines += [
            (f"{direction}: sent", *(str(link.sent) for link in links)),
            (f"{direction}: lost", *(f"{link.lost_share:.1%}" for link in links)),
            (f"{direction}: longest gap", *(f"{link.longest_gap_s:.2f} s" for link in links)),
            (f"{direction}: rate", *(f"{link.bytes_per_s / 1000:.1f} kB/s" for link in links)),
        ]
    return lines


def _number(value: float, unit: str, digits: int = 4) -> str:
    return NOTHING if math.isnan(value) else f"{value:.{digits}f} {unit}"
