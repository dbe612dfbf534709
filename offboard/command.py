"""Options and start-up of the offboard process: `dmrac offboard` and `python -m offboard`."""

import argparse
import os
import secrets
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Final, NamedTuple

from configs.addresses import is_loopback, seen_from_offboard
from configs.loader import ConfigError
from flight_log.writer import FlightLogWriter
from offboard.background import BackgroundThread
from offboard.config import OffboardConfig
from offboard.core import OffboardCore
from offboard.data.experience import ExperienceError
from offboard.links.vehicle_service import VehicleService
from offboard.memory.folder import memory_file, read_memory, remember
from offboard.memory.memory import UnusableMemoryError
from offboard.process import serve
from offboard.training.fleet import Fleet
from protocol.feature_config import fill_process
from protocol.keys import load_key
from protocol.session import session_number
from runtime.errors import StartError
from runtime.files import make_folder, write_last
from runtime.flight_options import FlightOptions, add_flight_options, flight_of
from runtime.kernel import THREAD_SWITCH_S
from runtime.signals import StopRequest
from runtime.sockets import AddressInUseError
from runtime.status import StatusLines

EXAMPLES: Final = """examples:
  dmrac offboard --onboard 10.0.0.2:14571 --key-file flight.key --out flight
  dmrac offboard --config flight.yaml --out flight
  dmrac offboard --config flight.yaml --out flight --resume flight/checkpoint.npz
  dmrac offboard --config flight.yaml --onboard 10.0.0.2:14571 --bind-link 10.0.0.7:14573 \\
      --bind-motion-capture 10.0.0.7:14574 --key-file flight.key --capture-key-file capture.key
  dmrac offboard --config first.yaml --also second.yaml --out flights      two vehicles, one trainer
  dmrac offboard --config flight.yaml --out flight --memory memory --remember
"""
OPTIONS: Final = {
    "radio_offboard": "--onboard",
    "offboard_link": "--bind-link",
    "motion_capture": "--bind-motion-capture",
    "key_file": "--key-file",
    "capture_key_file": "--capture-key-file",
}
"""The option that overrules each key of the configuration's `network`."""


class Vehicle(NamedTuple):
    """One vehicle to train for, before its sockets are open."""

    flight: FlightOptions
    config: OffboardConfig
    core: OffboardCore
    out: Path
    status: StatusLines


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `python -m offboard` and `dmrac offboard`."""
    add_flight_options(parser)
    parser.add_argument(
        "--also",
        type=Path,
        action="append",
        default=[],
        metavar="FILE",
        help="configuration of another vehicle to train for, in addition to --config; may be repeated. The files of "
        "each vehicle then go to a folder vehicle_ID in --out",
    )
    parser.add_argument("--out", type=Path, default=Path(), help="folder for log, checkpoints and summary")
    parser.add_argument("--onboard", metavar="HOST:PORT", help="address of the onboard process, or of the radio to it")
    parser.add_argument("--bind-link", metavar="HOST:PORT", help="own address for the link to onboard")
    parser.add_argument("--bind-motion-capture", metavar="HOST:PORT", help="own address for the motion capture")
    parser.add_argument("--key-file", metavar="FILE", help="key shared with onboard")
    parser.add_argument(
        "--capture-key-file", metavar="FILE", help="key of the motion capture's MAVLink: take signed poses only"
    )
    parser.add_argument(
        "--resume",
        type=Path,
        metavar="FILE",
        help="continue from a checkpoint, as after a restart; with --also: the --out folder of the earlier run",
    )
    parser.add_argument("--warm-start", type=Path, metavar="FILE", help="start from the features of a version file")
    parser.add_argument(
        "--memory", type=Path, metavar="FOLDER", help="start all vehicles from a memory, made by dmrac learn"
    )
    parser.add_argument(
        "--remember", action="store_true", help="add each vehicle's flight to the memory when the process ends"
    )
    parser.add_argument("--json", action="store_true", help="status as JSON lines, for a supervising program")


def run(arguments: argparse.Namespace) -> int:
    """Run the process; returns the exit status (0 served, 1 ended by failures, 2 bad configuration or address)."""
    stop = StopRequest()
    with ExitStack() as logs:
        try:
            vehicles = _vehicles(arguments)
            _load_torch(vehicles)
            services = _open_services(vehicles, logs, several=bool(arguments.also))
        except (ConfigError, StartError) as error:
            print(error, file=sys.stderr)
            return 2
        sys.setswitchinterval(THREAD_SWITCH_S)
        for vehicle in vehicles:
            network = vehicle.flight.network
            alone = ", from this machine only" if is_loopback(network.motion_capture) else ""
            captured = f"motion capture on {network.motion_capture}{alone}"
            vehicle.status.report(f"onboard {network.radio_offboard}, {captured}")
        for vehicle in vehicles:
            vehicle.status.report("ready")
        result = serve(services, stop)
    written = [_write_summary(vehicle, service) for vehicle, service in zip(vehicles, services, strict=True)]
    written += [_remember(vehicle) for vehicle in vehicles if vehicle.config.experience.remember]
    sys.stdout.flush()
    sys.stderr.flush()
    # does not wait for a round of training: torch must not be torn down under it
    os._exit(result if all(written) else 1)


def _load_torch(vehicles: Sequence[Vehicle]) -> None:
    """Load torch, which takes seconds, before the first pose waits for its relay; one thread, for this process.

    More threads make products this small slower, and one thread sums in a fixed order.
    """
    if any(vehicle.config.experience.mode == "learn" for vehicle in vehicles):
        import torch

        import offboard.training.round  # noqa: F401

        torch.set_num_threads(1)


def _open_services(vehicles: Sequence[Vehicle], logs: ExitStack, several: bool) -> list[VehicleService]:
    """Make the folders, and open logs and sockets.

    Raises
    ------
    StartError
        If a folder cannot be made or an address is taken. No socket is left open.
    """
    link, capture = (f"network.{name}" if several else OPTIONS[name] for name in ("offboard_link", "motion_capture"))
    background, services = BackgroundThread(), list[VehicleService]()
    for vehicle in vehicles:
        make_folder(vehicle.out)
    try:
        for vehicle in vehicles:
            metadata = {"seed": str(vehicle.config.seed), "insecure": vehicle.flight.network.insecure_links}
            attachments = {"config.yaml": vehicle.flight.text}
            file = vehicle.out / "offboard.mcap"
            core, network, out, status = vehicle.core, vehicle.flight.network, vehicle.out, vehicle.status
            writer = FlightLogWriter(file, "offboard", metadata, attachments, on_failure=status.fault)
            log = logs.enter_context(writer)
            services.append(VehicleService(core, network, log, out, status, background, (link, capture)))
    except AddressInUseError:
        for service in services:
            service.close()
        raise
    return services


def _write_summary(vehicle: Vehicle, service: VehicleService) -> bool:
    """Write the summary of one vehicle; False if that failed, or its log or another file before."""
    file = vehicle.out / "offboard_summary.json"
    try:
        summary = service.summary()
    except Exception as error:  # of any kind: the summaries of the other vehicles must still be written
        print(f"{file}: cannot be written: {error}", file=sys.stderr)
        return False
    return write_last(file, summary) and not service.unwritten


def _remember(vehicle: Vehicle) -> bool:
    """Add the flight of one vehicle to its memory; False if that failed."""
    experience, flight = vehicle.config.experience, vehicle.flight.tree.get("scenario", "flight")
    name = f"{flight}, {time.strftime('%Y-%m-%d %H:%M:%S')}"
    condition = vehicle.core.learner.condition(name)
    try:
        memory = remember(Path(experience.memory), condition, vehicle.config.features.trained)
    except Exception as error:  # of any kind: the flights of the other vehicles must still be added
        print(f"{experience.memory}: the flight cannot be added: {error}", file=sys.stderr)
        return False
    vehicle.status.report(f"{experience.memory}: {len(memory.conditions)} conditions")
    return True


def _vehicles(arguments: argparse.Namespace) -> list[Vehicle]:
    """The vehicles that the command line names, with what they learnt before. Raises ConfigError."""
    several, resume = bool(arguments.also), arguments.resume
    if several:
        _check_options(arguments)
    fleet = Fleet() if several else None
    vehicles = [_vehicle(arguments, path, fleet) for path in (arguments.config, *arguments.also)]
    _check_distinct(vehicles)
    _check_shared(vehicles)
    checkpoints = [_checkpoint_of(vehicle, resume) if several and resume else resume for vehicle in vehicles]
    if resume is not None and not any(checkpoints):
        raise ConfigError(f"--resume {resume}: holds no vehicle_N/checkpoint.npz of any of these vehicles")
    for vehicle, checkpoint in zip(vehicles, checkpoints, strict=True):
        _recall(vehicle)
        _load_experience(vehicle.core, checkpoint, arguments.warm_start)
    return vehicles


def _vehicle(arguments: argparse.Namespace, config_path: Path | None, fleet: Fleet | None) -> Vehicle:
    """One vehicle, with nothing learnt yet; without a fleet it is the only one. Raises ConfigError."""
    several = fleet is not None
    own = argparse.Namespace(**{**vars(arguments), "config": config_path})
    flight = flight_of(own, OPTIONS, {"--onboard": "HOST:PORT"}, seen_from_offboard)
    config = _with_memory(fill_process(OffboardConfig, flight.tree, flight.source, "offboard"), arguments)
    session = session_number(time.time_ns(), secrets.randbits(20))
    network = flight.network
    core = OffboardCore(config, session, load_key(network.key_file), fleet, load_key(network.capture_key_file))
    out = arguments.out / f"vehicle_{config.vehicle_id}" if several else arguments.out
    name = f"offboard {config.vehicle_id}" if several else "offboard"
    status = StatusLines(name, arguments.json, network.insecure_links)
    return Vehicle(flight, config, core, out, status)


def _with_memory(config: OffboardConfig, arguments: argparse.Namespace) -> OffboardConfig:
    """The configuration with the memory of the command line. Raises ConfigError."""
    memory = config.experience.memory if arguments.memory is None else str(arguments.memory)
    if arguments.remember and not memory:
        raise ConfigError("--remember: only with --memory FOLDER")
    if memory and arguments.warm_start is not None:
        raise ConfigError(f"--warm-start {arguments.warm_start}: not allowed with the memory {memory}")
    remembers = arguments.remember or config.experience.remember
    experience = config.experience.model_copy(update={"memory": memory, "remember": remembers})
    return config.model_copy(update={"experience": experience})


def _recall(vehicle: Vehicle) -> None:
    """Start from the configured memory, if any; one that is yet to begin is none. Raises ConfigError."""
    experience = vehicle.config.experience
    folder = Path(experience.memory)
    if not experience.memory or (experience.remember and not memory_file(folder).exists()):
        return
    try:
        vehicle.core.recall(read_memory(folder))
    except UnusableMemoryError as error:
        raise ConfigError(f"memory {folder}: {error}") from None


def _check_options(arguments: argparse.Namespace) -> None:
    """Raise ConfigError for options that apply to one vehicle only, when there are several."""
    if arguments.config is None:
        raise ConfigError("--also: needs --config FILE, the configuration of the first vehicle")
    for option in OPTIONS.values():
        if getattr(arguments, option.removeprefix("--").replace("-", "_")) is not None:
            raise ConfigError(f"{option}: not allowed with --also; each vehicle's file states its own, under network")
    if arguments.resume is not None and not arguments.resume.is_dir():
        raise ConfigError(f"--resume {arguments.resume}: with --also, give the --out folder of the earlier run")


def _check_distinct(vehicles: Sequence[Vehicle]) -> None:
    """Raise ConfigError if two vehicles have the same number or would share a socket."""
    users: dict[int | str, Vehicle] = {}
    for vehicle in vehicles:
        claims: dict[str, int | str] = {"offboard.vehicle_id": vehicle.config.vehicle_id}
        bound = vehicle.flight.network.bound_by_offboard()
        claims |= {f"network.{name}": address for name, address in bound.items()}
        for key, value in claims.items():
            if value in users:
                other = users[value].flight.source
                raise ConfigError(
                    f"{vehicle.flight.source}: {key}: {value} is used by {other}; each vehicle needs its own"
                )
            users[value] = vehicle


def _check_shared(vehicles: Sequence[Vehicle]) -> None:
    """Raise ConfigError where vehicles that share their networks have other networks or another training."""
    first, *others = vehicles
    if not any(vehicle.config.trainer.shared for vehicle in vehicles):
        return
    wanted = _shared_settings(first.config)
    for vehicle in others:
        for key, value in _shared_settings(vehicle.config).items():
            if value != wanted[key]:
                raise ConfigError(
                    f"{vehicle.flight.source}: {key}: {value}; allowed is {wanted[key]}, as in {first.flight.source}, "
                    "because the vehicles share their networks (offboard.trainer.shared)"
                )


def _shared_settings(config: OffboardConfig) -> dict[str, object]:
    """What the vehicles of a fleet have in common, by key."""
    sections = {"features.trained": config.features.trained, "offboard.trainer": config.trainer}
    return {f"{name}.{key}": value for name, section in sections.items() for key, value in section.model_dump().items()}


def _checkpoint_of(vehicle: Vehicle, folder: Path) -> Path | None:
    """The vehicle's checkpoint in the folder of an earlier run; None, and a line of status, if there is none."""
    checkpoint = folder / vehicle.out.name / "checkpoint.npz"
    if checkpoint.exists():
        return checkpoint
    vehicle.status.report(f"{checkpoint} does not exist: vehicle {vehicle.config.vehicle_id} starts without experience")
    return None


def _load_experience(core: OffboardCore, resume: Path | None, warm_start: Path | None) -> None:
    """Load a checkpoint and a version file into the core, where given. Raises ConfigError naming the file."""
    for path, load in ((resume, core.resume), (warm_start, core.warm_start)):
        if path is None:
            continue
        try:
            load(path.read_bytes())
        except OSError as error:
            raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None
        except (ExperienceError, ValueError) as error:
            raise ConfigError(f"{path}: {error}") from None
