"""Reads a recorded flight for a replay: configuration, deliveries of the link, trace and datagram log."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from configs.loader import ConfigError, parse_mapping
from configs.named_class import UntrustedClassError, classes_for
from experiments.flights.lockstep_flight import Deliveries
from experiments.flights.lockstep_log import EXPERIENCE
from experiments.flights.scenario import FlightConfig, fill_flight
from experiments.flights.trace import FlightTrace, trace_of
from flight_log.log_file import LogFile
from flight_log.reader import Flight, FlightError, open_flight
from sim_vehicle.link.radio import DELIVERY, DIRECTIONS, Delivery, Direction, delivery_from_vector

CONFIG_NAME: Final = "config.yaml"


@dataclass(frozen=True)
class RecordedFlight:
    """The content of a flight's folder."""

    path: Path
    config: FlightConfig
    deliveries: Deliveries
    """By direction; empty if none were logged."""
    trace: FlightTrace | None
    """None if a log is missing or empty."""
    summary: dict[str, Any]
    """Content of summary.json; empty if there is none."""
    onboard_logs: Sequence[LogFile]
    """One for each run of the onboard process, in their order."""
    with_offboard: bool
    lockstep: bool
    experience: bytes | None
    """Experience that a lockstep flight started from; None for none."""
    core: str
    """Name of the onboard core, of onboard.cores.CORES."""


def read_recorded(path: Path, trust: bool = False) -> RecordedFlight:
    """Read a flight's folder.

    trust: whether classes that its configuration names are imported if they are not part of this project.

    Raises
    ------
    ConfigError
        If it is not a flight of this project, or its configuration belongs to another version, or names such a class.
    """
    try:
        flight = open_flight(path)
        summary = flight.summary
    except FlightError as error:
        raise ConfigError(str(error)) from None
    onboard = [log for log in flight.logs if log.process == "onboard"]
    about = onboard[-1].metadata if onboard else {}
    return RecordedFlight(
        path=path,
        config=_config(flight, path, trust),
        deliveries=read_deliveries(flight),
        trace=trace_of(flight),
        summary=summary,
        onboard_logs=onboard,
        with_offboard=about.get("with_offboard", "True") == "True",
        lockstep=about.get("clock") == "lockstep",
        experience=onboard[-1].attachments.get(EXPERIENCE) if onboard else None,
        core=about.get("core", "numpy"),
    )


def read_deliveries(flight: Flight) -> dict[Direction, list[Delivery]]:
    """Return the deliveries that the radio logged, by direction."""
    deliveries: dict[Direction, list[Delivery]] = {direction: [] for direction in DIRECTIONS}
    table = flight.get(DELIVERY.topic)
    if table is not None and table.names == DELIVERY.names:
        for row in table.values:
            direction, delivery = delivery_from_vector(row)
            deliveries[direction].append(delivery)
    return deliveries


def _config(flight: Flight, path: Path, trust: bool) -> FlightConfig:
    for attachments in flight.attachments.values():
        if CONFIG_NAME in attachments:
            source = f"{path}: {CONFIG_NAME}"
            tree = parse_mapping(attachments[CONFIG_NAME].decode(), source)
            try:
                with classes_for(trust):
                    config = fill_flight(tree, source)
                    config.onboard.controller.controller_class(source)
            except UntrustedClassError as error:
                raise UntrustedClassError(f"{source}: {error}") from None
            return config
    raise ConfigError(f"{path}: its logs have no {CONFIG_NAME}, so its configuration is unknown")
