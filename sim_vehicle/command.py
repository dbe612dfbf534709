"""Options and start-up of the simulated vehicle: `dmrac sim` and `python -m sim_vehicle`."""

import argparse
import sys
from pathlib import Path
from typing import Any, Final, get_args

import numpy as np

from configs.addresses import load_network, serial_line
from configs.loader import ConfigError, fill_section, load_section, merge, read_tree
from flight_log.writer import FlightLogWriter
from protocol.keys import load_key
from runtime.errors import StartError
from runtime.files import make_folder, write_last
from runtime.flight_options import add_insecure_option
from runtime.kernel import prepare_interpreter, request_realtime
from runtime.signals import StopRequest
from runtime.sockets import AddressInUseError
from runtime.status import StatusLines
from sim_vehicle.config import PhysicsName, SimVehicleConfig
from sim_vehicle.link.radio import RADIO_STREAM, Radio, RadioConfig
from sim_vehicle.process import SimProcess
from sim_vehicle.vehicle import PERIOD_NS, SimVehicle

WARM_UP_STEPS: Final = 20
PRIORITY: Final = 10
"""SCHED_FIFO, below that of onboard: the simulator must not delay onboard's loop."""

EXAMPLES: Final = """examples:
  dmrac sim --config flight.yaml --out flight
  dmrac sim --config flight.yaml --physics mujoco
  dmrac sim --config flight.yaml --bind-vehicle 192.168.3.1:14560 --onboard 192.168.3.2:14561 \\
      --vehicle-key-file vehicle.key
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `python -m sim_vehicle` and `dmrac sim`."""
    parser.add_argument("--config", type=Path, required=True, help="resolved configuration of a flight (YAML)")
    parser.add_argument("--out", type=Path, default=Path(), help="folder for log and summary (default: here)")
    parser.add_argument(
        "--physics",
        choices=get_args(PhysicsName),
        help="instead of the configuration's: own, MuJoCo (extra `mujoco`) or RotorPy (extra `rotorpy`)",
    )
    parser.add_argument("--onboard", metavar="HOST:PORT", help="onboard's address for the vehicle's MAVLink")
    parser.add_argument("--onboard-link", metavar="HOST:PORT", help="onboard's address for the radio")
    parser.add_argument("--offboard-link", metavar="HOST:PORT", help="offboard's address for the radio")
    parser.add_argument("--motion-capture", metavar="HOST:PORT", help="offboard's address for motion capture")
    parser.add_argument("--bind-vehicle", metavar="HOST:PORT", help="own MAVLink address")
    parser.add_argument("--bind-radio-onboard", metavar="HOST:PORT", help="own radio address towards onboard")
    parser.add_argument("--bind-radio-offboard", metavar="HOST:PORT", help="own radio address towards offboard")
    parser.add_argument("--vehicle-key-file", metavar="FILE", help="key of the MAVLink to onboard: sign it")
    parser.add_argument("--capture-key-file", metavar="FILE", help="key of the motion capture's MAVLink: sign it")
    add_insecure_option(parser)
    parser.add_argument("--json", action="store_true", help="status as JSON lines, for a supervising program")


def run(arguments: argparse.Namespace) -> int:
    """Run the process. Returns the exit status.

    0 flown, 1 no command from onboard or the record is incomplete, 2 bad configuration or address.
    """
    stop = StopRequest()
    try:
        seed, duration_s = _seed_and_duration(arguments.config)
        over = {} if arguments.physics is None else {"vehicle": {"physics": arguments.physics}}
        tree = merge(read_tree(arguments.config), over)
        config = fill_section(SimVehicleConfig, tree, str(arguments.config), "vehicle")
        radio_config = load_section(RadioConfig, arguments.config, "radio")
        network = load_network(arguments.config, _addresses(arguments))
        status = StatusLines("sim", arguments.json, network.insecure_links)
        key = load_key(network.vehicle_key_file)
        if serial_line(network.vehicle) is not None:
            raise StartError(f"network.vehicle: {network.vehicle}: the simulated vehicle supports UDP only")
        vehicle = _warm_vehicle(config, seed, key, load_key(network.capture_key_file))
        make_folder(arguments.out)
    except (ConfigError, StartError) as error:
        print(error, file=sys.stderr)
        return 2
    radio = Radio(radio_config, np.random.default_rng([seed, RADIO_STREAM]), start_ns=0)
    attachments = {"config.yaml": arguments.config.read_bytes()}
    about = {"seed": str(seed), "physics": config.physics}
    file = arguments.out / "sim_vehicle.mcap"
    log = FlightLogWriter(file, "sim_vehicle", about, attachments, on_failure=status.fault)
    try:
        process = SimProcess(vehicle, radio, network, duration_s, log, status, stop)
        request_realtime(PRIORITY)
        prepare_interpreter()
        status.report("ready")
        result = process.fly()
        process.close()
    except AddressInUseError as error:
        print(error, file=sys.stderr)
        return 2
    finally:
        log.close()
    written = write_last(arguments.out / "sim_summary.json", process.summary() | {"log_failure": log.failure})
    return result or int(not written or bool(log.failure))


def _addresses(arguments: argparse.Namespace) -> dict[str, Any]:
    return {
        "onboard_vehicle": arguments.onboard,
        "onboard_link": arguments.onboard_link,
        "offboard_link": arguments.offboard_link,
        "motion_capture": arguments.motion_capture,
        "vehicle": arguments.bind_vehicle,
        "radio_onboard": arguments.bind_radio_onboard,
        "radio_offboard": arguments.bind_radio_offboard,
        "vehicle_key_file": arguments.vehicle_key_file,
        "capture_key_file": arguments.capture_key_file,
        "insecure": tuple(arguments.insecure),
    }


def _warm_vehicle(config: SimVehicleConfig, seed: int, key: bytes | None, capture_key: bytes | None) -> SimVehicle:
    """The vehicle. Another one is stepped first, so that no step of the flight waits for the compiler.

    Raises ConfigError as SimVehicle does.
    """
    vehicle = SimVehicle(config, seed)
    for step in range(WARM_UP_STEPS):
        vehicle.step(step * PERIOD_NS)
    return SimVehicle(config, seed, key, capture_key)


def _seed_and_duration(path: Path) -> tuple[int, float]:
    tree = read_tree(path)
    seed, duration_s = tree.get("seed"), tree.get("duration_s")
    if not isinstance(seed, int) or not isinstance(duration_s, int | float) or duration_s <= 0:
        raise ConfigError(f"{path}: seed {seed!r}, duration_s {duration_s!r}: expected a whole number and seconds")
    return seed, float(duration_s)
