"""The public functions of async_dmrac: fly once, fly a campaign, read a record or a campaign file."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from async_dmrac.record import CampaignResult, Flight
from configs.addresses import LINK_KEYS
from configs.loader import ConfigError, fill, read_tree
from configs.user_class import SESSION, name_of
from experiments.flights.flight_folder import clear_folder, make_folder
from experiments.flights.logged_flight import fly_logged
from experiments.flights.realtime_flight import require_free_ports
from experiments.flights.scenario import DEFAULT_SCENARIO, Choices, FlightConfig, resolve
from flight_log.reader import open_flight
from onboard.cores import CORES
from protocol.keys import load_key
from runtime.errors import StartError
from runtime.kernel import cores
from sim_vehicle.world.catalogue import kind_of
from sim_vehicle.world.interface import Disturbance

__all__ = ["campaign", "campaign_file", "configure", "fly", "load_flight"]


def configure(
    scenario: str = DEFAULT_SCENARIO,
    controller: str | type | None = None,
    seed: int | None = None,
    *,
    duration_s: float | None = None,
    set: Mapping[str, Any] | None = None,  # noqa: A002 the same word as the option --set
    settings: Mapping[str, Any] | None = None,
    disturbances: Sequence[Disturbance] = (),
) -> FlightConfig:
    """Return the whole checked configuration of a flight; nothing is flown. Arguments and errors as for `fly`."""
    assignments = [f"{path}={_as_yaml(value)}" for path, value in (set or {}).items()]
    law = None
    if isinstance(controller, type):
        law = {"class": name_of(controller), "settings": dict(settings or {})}
        controller = controller.__name__
    elif settings is not None:
        raise ConfigError("settings: only with a class as controller; else use set={'onboard.controller.settings...'}")
    own = [_plain(one) for one in disturbances]
    choices = Choices(controller, seed, duration_s, assignments, law=law, disturbances=own)
    return resolve(scenario, choices)


def fly(
    scenario: str = DEFAULT_SCENARIO,
    controller: str | type | None = None,
    seed: int | None = None,
    *,
    duration_s: float | None = None,
    set: Mapping[str, Any] | None = None,  # noqa: A002 the same word as the option --set
    settings: Mapping[str, Any] | None = None,
    disturbances: Sequence[Disturbance] = (),
    core: str = "numpy",
    offboard: bool = True,
    realtime: bool = False,
    out: str | Path | None = None,
) -> Flight:
    """Fly a scenario and return its record.

    Parameters
    ----------
    scenario: a name in configs/scenarios, or the path of a YAML file.
    controller: a name in configs/controllers, the path of a YAML file, or a class (`Controller`), also one that was
        defined in a notebook. None: the scenario's.
    seed: of everything random, 0 or more; None: the scenario's.
    duration_s: s, the whole flight from boot to touch-down; None: the scenario's.
    set: values by path, such as {"vehicle.body.mass_kg": 0.07}.
    settings: values of the class's `Settings`.
    disturbances: added to those of the scenario, such as `Wind(...)` or one of your own (`Disturbance`).
    core: onboard's core, "numpy" or "c". The core in C flies in lockstep only, and the shipped controllers only.
    offboard: False: without the trainer, so without poses from motion capture; lockstep only.
    realtime: three processes over UDP in real time, instead of one process in virtual time (lockstep).
    out: folder of the record; None: flights/<time>_<scenario>.

    Raises
    ------
    ConfigError
        If an argument or a value is wrong: names it, and what is allowed.
    StartError
        In real time: if a process does not start or an address is in use.
    """
    own: dict[str, Any] = {"duration_s": duration_s, "set": set, "settings": settings, "disturbances": disturbances}
    config = configure(scenario, controller, seed, **own)
    _require_flyable(config, core, offboard, realtime)
    folder = make_folder(None if out is None else Path(out), config.scenario)
    before = tuple(folder.iterdir())
    try:
        fly_logged(config, folder, not realtime, offboard, core=core)
    except (ConfigError, StartError):
        clear_folder(folder, before)
        raise
    return load_flight(folder)


def load_flight(folder: str | Path) -> Flight:
    """Read a recorded flight: a folder with one log per process, or a single log file.

    Raises
    ------
    FlightError
        If there is no log, or none that can be read.
    """
    found = open_flight(Path(folder))
    return Flight(found.path, found.logs)


def campaign(
    campaign: str | Mapping[str, Any],
    *,
    out: str | Path | None = None,
    seeds: int | None = None,
    jobs: int | None = None,
    core: str = "numpy",
    resume: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> CampaignResult:
    """Fly scenarios x controllers x sweeps x seeds, side by side in processes, and return one row per flight.

    A script that calls this needs `if __name__ == "__main__":` around the call, because the processes import it.

    Parameters
    ----------
    campaign: a name in configs/campaigns, the path of a YAML file, or the content of such a file.
    out: folder of the rows; None: campaigns/<name>. With `resume` flights that are there already are not flown again.
    seeds: seeds per point; None: the campaign's.
    jobs: flights side by side; None: one per core.
    core: onboard's core, "numpy" or "c".
    progress: called after every flight with the flights that are done, and all.

    Raises
    ------
    ConfigError
        If the campaign cannot be used, or the folder holds one already and `resume` is False.
    """
    from experiments.campaigns.campaign import CampaignConfig, load_campaign
    from experiments.campaigns.runner import CampaignRun, open_store, prepare_folder, run_campaign
    from experiments.campaigns.worker_pools import LocalPool

    _require_core(core)
    if isinstance(campaign, str):
        config, path = load_campaign(campaign)
        name = path.stem
    else:
        config, name = fill(CampaignConfig, campaign, "campaign"), "campaign"
    folder = Path("campaigns") / name if out is None else Path(out)
    run = CampaignRun(config, name, folder, seeds, core=core)
    prepare_folder(run, resume)
    with open_store(folder) as store:
        report = (lambda state: progress(state.done, state.total)) if progress else (lambda state: None)
        result = run_campaign(run, store, LocalPool(jobs or cores()), report)
    return CampaignResult(folder, result.total, result.flown, result.lost, result.errors)


def campaign_file(name: str) -> dict[str, Any]:
    """Return the content of a campaign file, to change and hand to `campaign`.

    Parameters
    ----------
    name: a name in configs/campaigns, or the path of a YAML file.

    Raises
    ------
    ConfigError
        If there is no such campaign.
    """
    from experiments.campaigns.campaign import campaign_file as path_of

    return read_tree(path_of(name))


def _require_flyable(config: FlightConfig, core: str, offboard: bool, realtime: bool) -> None:
    """Raise ConfigError or StartError for what would fail after the start."""
    _require_core(core)
    if realtime and (core != "numpy" or not offboard):
        raise ConfigError("realtime=True: allowed with core='numpy' and offboard=True only")
    if realtime:
        _require_classes_for_processes(config)
        require_free_ports(config.network)
    for key in LINK_KEYS.values():
        load_key(getattr(config.network, key.setting))


def _require_core(core: str) -> None:
    if core not in CORES:
        raise ConfigError(f"core: {core!r}: allowed are {', '.join(CORES)}")


def _require_classes_for_processes(config: FlightConfig) -> None:
    """Raise ConfigError if a class exists in this Python process only, which the others of a real-time flight are not.

    Raises
    ------
    ConfigError
        Naming the class.
    """
    names = [config.onboard.controller.class_path, *(one.kind for one in config.vehicle.disturbances)]
    for name in names:
        if name.startswith(f"{SESSION}:"):
            raise ConfigError(
                f"realtime=True: {name.partition(':')[2]} is defined in this Python session, which the processes of a"
                " real-time flight cannot read; write the class into a file and import it"
            )


def _plain(disturbance: Disturbance) -> dict[str, Any]:
    """A disturbance as it stands in a scenario file. Raises ConfigError for an object that is none."""
    if not isinstance(disturbance, Disturbance):
        raise ConfigError(f"disturbances: {disturbance!r}: expected instances of async_dmrac.Disturbance")
    given: dict[str, Any] = disturbance.model_dump(mode="json", exclude_unset=True)
    return {**given, "kind": kind_of(type(disturbance))}


def _as_yaml(value: Any) -> str:
    """One value as YAML on one line."""
    return yaml.safe_dump(value, default_flow_style=True, width=10**6).removesuffix("\n...\n").strip()
