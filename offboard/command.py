"""Options and start-up of the offboard process: `dmrac offboard` and `python -m offboard`."""

import argparse
import os
import secrets
import sys
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from configs.addresses import seen_from_offboard
from configs.loader import ConfigError, fill_section
from flight_log.writer import FlightLogWriter
from offboard.background import BackgroundThread
from offboard.config import OffboardConfig
from offboard.core import OffboardCore
from offboard.data.experience import ExperienceError
from offboard.links.vehicle_service import VehicleService
from offboard.process import serve
from protocol.keys import load_key
from protocol.session import session_number
from runtime.errors import StartError
from runtime.files import make_folder, write_json
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
      --bind-motion-capture 10.0.0.7:14574 --key-file flight.key
  dmrac offboard --config first.yaml --also second.yaml --out flights      two vehicles, one trainer
"""
OPTIONS: Final = {
    "radio_offboard": "--onboard",
    "offboard_link": "--bind-link",
    "motion_capture": "--bind-motion-capture",
    "key_file": "--key-file",
}
"""What overrules which key of the configuration's network."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `python -m offboard` and `dmrac offboard`."""
    add_flight_options(parser)
    parser.add_argument(
        "--also",
        type=Path,
        action="append",
        default=[],
        metavar="FILE",
        help="configuration of one more vehicle to train for, beside --config; may be repeated. Each vehicle's files "
        "then go to a folder vehicle_ID of --out",
    )
    parser.add_argument("--out", type=Path, default=Path(), help="folder for log, checkpoints and summary")
    parser.add_argument("--onboard", metavar="HOST:PORT", help="the onboard process, or the radio towards it")
    parser.add_argument("--bind-link", metavar="HOST:PORT", help="own address towards onboard")
    parser.add_argument("--bind-motion-capture", metavar="HOST:PORT", help="own address for the motion capture")
    parser.add_argument("--key-file", metavar="FILE", help="key shared with onboard")
    parser.add_argument(
        "--resume",
        type=Path,
        metavar="FILE",
        help="go on from a checkpoint, as after a restart; with --also: the --out of the run before",
    )
    parser.add_argument("--warm-start", type=Path, metavar="FILE", help="start from the features of a version file")
    parser.add_argument("--json", action="store_true", help="status as JSON lines, for a supervising program")


@dataclass(frozen=True)
class Vehicle:
    """One vehicle to train for, before its sockets are open."""

    flight: FlightOptions
    config: OffboardConfig
    core: OffboardCore
    out: Path
    status: StatusLines


def run(arguments: argparse.Namespace) -> int:
    """Run the process; returns the exit status (0 served, 1 ended by failures, 2 bad configuration or address)."""
    stop = StopRequest()
    try:
        vehicles = _vehicles(arguments)
        if any(vehicle.config.experience.mode == "learn" for vehicle in vehicles):
            import offboard.training.round  # noqa: F401  torch takes seconds to load: before poses wait, not between them
        for vehicle in vehicles:
            make_folder(vehicle.out)
    except (ConfigError, StartError) as error:
        print(error, file=sys.stderr)
        return 2
    bound = ("offboard_link", "motion_capture")
    link, capture = (f"network.{name}" if arguments.also else OPTIONS[name] for name in bound)
    worker = BackgroundThread()
    logs: list[FlightLogWriter] = []
    services: list[VehicleService] = []
    try:
        for vehicle in vehicles:
            attachments = {"config.yaml": vehicle.flight.text}
            seed = {"seed": str(vehicle.config.seed)}
            logs.append(FlightLogWriter(vehicle.out / "offboard.mcap", "offboard", seed, attachments))
            network = vehicle.flight.network
            services.append(
                VehicleService(vehicle.core, network, logs[-1], vehicle.out, vehicle.status, worker, (link, capture))
            )
        sys.setswitchinterval(THREAD_SWITCH_S)
        for vehicle in vehicles:
            network = vehicle.flight.network
            heard = f"motion capture is heard on {network.motion_capture}"
            vehicle.status.report(f"onboard {network.radio_offboard}, {heard}")
        for vehicle in vehicles:
            vehicle.status.report("ready")
        result = serve(services, stop)
    except AddressInUseError as error:
        for service in services:
            service.close()
        print(error, file=sys.stderr)
        return 2
    finally:
        for log in logs:
            log.close()
    for vehicle, service in zip(vehicles, services, strict=True):
        file = vehicle.out / "offboard_summary.json"
        try:
            write_json(file, service.summary())
        except Exception as error:  # whatever it is: the other vehicles' summaries are still to be written
            print(f"{file}: cannot be written: {error}", file=sys.stderr)
            result = 1
    # A round of training may still run; nobody waits for it, and torch must not be torn down under it.
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(result)


def _vehicles(arguments: argparse.Namespace) -> list[Vehicle]:
    """All vehicles that the command line names. Raises ConfigError."""
    _check_several(arguments)
    several = bool(arguments.also)
    resumed = False
    vehicles: dict[int, Vehicle] = {}
    for path in (arguments.config, *arguments.also):
        one = argparse.Namespace(**{**vars(arguments), "config": path})
        flight = flight_of(one, OPTIONS, {"--onboard": "HOST:PORT"}, seen_from_offboard)
        config = fill_section(OffboardConfig, flight.tree, flight.source, "offboard")
        number = config.vehicle_id
        if number in vehicles:
            raise ConfigError(
                f"{path}: offboard.vehicle_id: {number} is that of {vehicles[number].flight.source} already; "
                "each vehicle needs its own"
            )
        key = load_key(flight.network.key_file)
        core = OffboardCore(config, session_number(time.time_ns(), secrets.randbits(20)), key)
        folder = f"vehicle_{number}" if several else "."
        status = StatusLines(f"offboard {number}" if several else "offboard", arguments.json)
        vehicles[number] = Vehicle(flight, config, core, arguments.out / folder, status)
        checkpoint = arguments.resume
        if several and checkpoint is not None:
            checkpoint = checkpoint / folder / "checkpoint.npz"
            if not checkpoint.exists():
                status.report(f"{checkpoint} is not there: vehicle {number} starts anew")
                checkpoint = None
        resumed |= checkpoint is not None
        _load_experience(core, checkpoint, arguments.warm_start)
    _check_addresses(vehicles.values())
    if several and arguments.resume is not None and not resumed:
        raise ConfigError(f"--resume {arguments.resume}: holds no vehicle_N/checkpoint.npz of any of these vehicles")
    return list(vehicles.values())


def _check_several(arguments: argparse.Namespace) -> None:
    """Raises ConfigError for options that can be meant for one vehicle only, where there are several."""
    if not arguments.also:
        return
    if arguments.config is None:
        raise ConfigError("--also: only beside --config FILE, the first vehicle's")
    for option in OPTIONS.values():
        if getattr(arguments, option.removeprefix("--").replace("-", "_")) is not None:
            raise ConfigError(f"{option}: not beside --also; each vehicle's file holds its own, under network")
    if arguments.resume is not None and not arguments.resume.is_dir():
        raise ConfigError(f"--resume {arguments.resume}: beside --also the folder is wanted that was --out before")


def _check_addresses(vehicles: Iterable[Vehicle]) -> None:
    """Raises ConfigError if two vehicles would share a socket."""
    bound: dict[str, Vehicle] = {}
    for vehicle in vehicles:
        for name, address in vehicle.flight.network.bound_by_offboard().items():
            if address in bound:
                raise ConfigError(
                    f"{vehicle.flight.source}: network.{name}: {address} is taken by {bound[address].flight.source} "
                    "already; each vehicle needs its own"
                )
            bound[address] = vehicle


def _load_experience(core: OffboardCore, resume: Path | None, warm_start: Path | None) -> None:
    """Whatever the core is to start from. Raises ConfigError naming the file."""
    for path, load in ((resume, core.resume), (warm_start, core.warm_start)):
        if path is None:
            continue
        try:
            load(path.read_bytes())
        except OSError as error:
            raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None
        except (ExperienceError, ValueError) as error:
            raise ConfigError(f"{path}: {error}") from None
