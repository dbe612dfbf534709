"""The public functions of async_dmrac. The command line does the same and adds options and printing."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from configs.loader import ConfigError
from experiments.flights.flight_folder import clear_folder, make_folder
from experiments.flights.logged_flight import fly_logged
from experiments.flights.realtime_flight import require_free_ports
from experiments.flights.scenario import DEFAULT_SCENARIO, Choices, resolve
from flight_log.reader import Flight, open_flight
from runtime.errors import StartError

__all__ = ["Flight", "fly", "load_flight"]


def fly(
    scenario: str = DEFAULT_SCENARIO,
    controller: str | None = None,
    seed: int | None = None,
    *,
    duration_s: float | None = None,
    set: Mapping[str, Any] | None = None,  # noqa: A002 the same word as the option --set
    realtime: bool = False,
    out: str | Path | None = None,
) -> Flight:
    """Fly a scenario and return its record.

    Parameters
    ----------
    scenario, controller: names in configs/, or paths of YAML files. controller None: the scenario's.
    seed: of everything random, 0 or more; None: the scenario's.
    duration_s: s, the whole flight from boot to touch-down; None: the scenario's.
    set: values by path, such as {"vehicle.body.mass_kg": 0.07}.
    realtime: three processes over UDP in real time, instead of one process in virtual time (lockstep).
    out: folder of the record; None: flights/<time>_<scenario>.

    Raises
    ------
    ConfigError
        If an argument or a value is wrong: names it, and what is allowed.
    StartError
        In real time: if a process does not start or an address is in use.
    """
    assignments = [f"{path}={_as_yaml(value)}" for path, value in (set or {}).items()]
    config = resolve(scenario, Choices(controller, seed, duration_s, assignments))
    if realtime:
        require_free_ports(config.network)
    folder = make_folder(None if out is None else Path(out), config.scenario)
    before = tuple(folder.iterdir())
    try:
        fly_logged(config, folder, lockstep=not realtime)
    except (ConfigError, StartError):
        clear_folder(folder, before)
        raise
    return open_flight(folder)


def load_flight(folder: str | Path) -> Flight:
    """Read a recorded flight: a folder with one log per process, or a single log file.

    Raises
    ------
    FlightError
        If there is no log, or none that can be read.
    """
    return open_flight(Path(folder))


def _as_yaml(value: Any) -> str:
    """One value as YAML on one line."""
    return yaml.safe_dump(value, default_flow_style=True, width=10**6).removesuffix("\n...\n").strip()
