"""Flies for a long time in real time while processes are stopped, killed and restarted and ports are flooded.

Theory of operation. Every link has a key. The vehicle's poses go to `dmrac mocap`, which signs them for offboard, so
that the motion capture is a process of its own. The radio is part of the vehicle's process: what happens on the link is
in its configuration. The cell is as large as the flight is long. This process looks every TURN_S at what is due, at
how long onboard waited for a processor, and now and then at every process's memory.
"""

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from configs.addresses import Addresses
from experiments.flights.realtime_flight import OVERTIME_S, require_free_ports
from experiments.flights.scenario import Choices, FlightConfig, resolve
from experiments.link.flood import keyed
from experiments.soak.crew import Crew, Done
from experiments.soak.schedule import Action, Disruption, blackouts, draw
from experiments.soak.watch import MEMORY_EVERY_S, Life, Waits
from onboard.flight.modes import FlightMode
from runtime.signals import StopRequest
from runtime.sockets import require_free, split_address

MINUTES_MAX: Final = 59.0
MINUTES_MIN: Final = 0.6
BATTERY_S: Final = 200.0
"""A full cell flies so long with room to spare: on the figure-8 in wind it is at its limit after 275 s."""
TURN_S: Final = 0.05
ON_THE_GROUND_S: Final = 0.2
"""After onboard is ready, and before the vehicle is calibrated: here it may be killed."""
PRIORITY: Final = 5
"""SCHED_FIFO, below the vehicle and onboard: a stop must not get longer because this process waits."""
ON_THE_FLOOR: Final = (FlightMode.LANDED.name, FlightMode.READY.name, FlightMode.TERMINATED.name)
"""After the flight, in time or not, there is nothing left to disturb."""
ON_THE_GROUND: Final = Disruption(0.0, Action.KILL, "onboard", 0.0)


@dataclass(frozen=True)
class SoakRun:
    """What a soak left, to be judged."""

    config: FlightConfig
    seed: int
    done: list[Done]
    lives: list[Life]
    waits: Waits
    begin_ns: int
    """Monotonic clock, when onboard began to fly."""
    status: dict[str, dict[str, Any]]
    events: dict[str, int]
    faults: list[str]
    exit_status: dict[str, int | None]
    interrupted: bool


def configuration(scenario: str, minutes: float, seed: int, assignments: tuple[str, ...]) -> FlightConfig:
    """Resolve the flight of a soak, with the link that the seed draws. Raises ConfigError."""
    duration_s = 60.0 * minutes
    windows = blackouts(seed, duration_s)
    capacity_mah = resolve(scenario).vehicle.battery.capacity_mah * max(1.0, duration_s / BATTERY_S)
    own = (f"vehicle.battery.capacity_mah={capacity_mah:.0f}", *windows, *assignments)
    return resolve(scenario, Choices(seed=seed, duration_s=duration_s, assignments=own))


def listening_address(network: Addresses) -> str:
    """Where `dmrac mocap` gets the unsigned poses: the port above the motion capture's."""
    _, port = split_address(network.motion_capture)
    return f"127.0.0.1:{port + 1}"


def soak(config: FlightConfig, out: Path, seed: int, show: Callable[[str], None] = lambda text: None) -> SoakRun:
    """Fly, and disturb all processes but the vehicle's.

    Parameters
    ----------
    config: from `configuration`.
    out: the folder of the record, which exists; it gets a new key for every link, in files for their owner only.
    show: called with a line for everything that is done.

    Raises
    ------
    AddressInUseError
        If an address is in use; nothing was started.
    FlightStartError
        If a process does not start; all were ended.
    """
    config = keyed(config, out)
    listen = listening_address(config.network)
    require_free_ports(config.network)
    require_free({"the motion capture's relay": listen})
    crew = Crew(config, _write_configs(config, listen, out), listen, out)
    stop = StopRequest()
    _raise_priority()
    due = draw(seed, config.duration_s, floods=os.geteuid() == 0)
    try:
        begin_ns, waits = _begin(crew)
        _watch(crew, waits, due, begin_ns, config.duration_s, stop, show)
    finally:
        exit_status = crew.end()
    return SoakRun(
        *(config, seed, crew.done, crew.lives, waits, begin_ns, crew.status, dict(crew.events), crew.faults),
        *(exit_status, stop.count > 0),
    )


def _write_configs(config: FlightConfig, listen: str, out: Path) -> dict[str, Path]:
    """Write the configurations, the vehicle's with unsigned poses to the relay; return the files by process."""
    all_but_one, vehicle = out / "config.yaml", out / "vehicle_config.yaml"
    all_but_one.write_text(config.to_yaml(), encoding="utf-8")
    network = config.network.model_dump() | {"motion_capture": listen, "capture_key_file": None}
    own = config.model_copy(update={"network": Addresses.model_validate(network)})
    vehicle.write_text(own.to_yaml(), encoding="utf-8")
    return {"sim": vehicle, "offboard": all_but_one, "onboard": all_but_one}


def _begin(crew: Crew) -> tuple[int, Waits]:
    """Start all processes, and onboard twice: it is killed before the vehicle flies. Return when it began."""
    for name in ("sim", "offboard", "capture", "ground"):
        crew.start(name)
    crew.wait_until_ready("sim", "offboard", "capture", "ground")
    crew.start("onboard")
    crew.wait_until_ready("onboard")
    begin_ns = time.monotonic_ns()
    crew.read(ON_THE_GROUND_S)
    crew.disrupt(ON_THE_GROUND)
    while not crew.done[-1].end_ns:
        crew.attend()
        crew.read(TURN_S)
    return begin_ns, Waits(crew.children["onboard"].process.pid)


def _watch(
    crew: Crew,
    waits: Waits,
    due: list[Disruption],
    begin_ns: int,
    duration_s: float,
    stop: StopRequest,
    show: Callable[[str], None],
) -> None:
    """Do what is due until the vehicle's process or onboard has ended, or somebody asks to end."""
    memory_s = 0.0
    waiting, flown = list(due), False
    while crew.children["sim"].running and crew.children["onboard"].running and stop.count == 0:
        crew.read(TURN_S)
        crew.attend()
        now_ns = time.monotonic_ns()
        waits.note(now_ns)
        flight_s = (now_ns - begin_ns) * 1e-9
        if waiting and flight_s >= waiting[0].at_s:
            show(f"{flight_s:8.1f} s  {waiting[0]}  ({crew.status.get('onboard', {}).get('mode', '-')})")
            crew.disrupt(waiting.pop(0))
        if now_ns * 1e-9 >= memory_s:
            memory_s = now_ns * 1e-9 + MEMORY_EVERY_S
            for life in crew.lives:
                life.note(now_ns * 1e-9)
        mode = crew.status.get("onboard", {}).get("mode")
        flown = flown or mode == FlightMode.FLYING.name
        if flight_s > duration_s + OVERTIME_S or (flown and mode in ON_THE_FLOOR):
            return


def _raise_priority() -> None:
    """Let this process wake on time, where that is allowed; not its children."""
    policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
    try:
        os.sched_setscheduler(0, policy, os.sched_param(PRIORITY))
    except OSError:
        return
