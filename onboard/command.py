"""Options and start-up of the onboard process: `dmrac onboard` and `python -m onboard`."""

import argparse
import secrets
import sys
import time
from pathlib import Path
from typing import Final

from configs.addresses import is_loopback, seen_from_onboard
from configs.loader import ConfigError
from flight_log.writer import FlightLogWriter
from onboard.config import OnboardConfig
from onboard.core import OnboardCore
from onboard.preflight.certificate import Clearance, arming_refusal, certificate_name, read_certificate, vehicle_url
from onboard.process import OnboardProcess, Sockets
from protocol.feature_config import fill_process
from protocol.keys import load_keys
from protocol.session import session_number
from runtime.errors import StartError
from runtime.files import make_folder, write_last
from runtime.flight_options import add_flight_options, flight_of
from runtime.kernel import prepare_interpreter, request_realtime
from runtime.signals import StopRequest
from runtime.status import StatusLines

EXAMPLES: Final = """examples:
  dmrac onboard --vehicle udp://192.168.3.1:14560 --vehicle-key-file vehicle.key \\
      --offboard 10.0.0.7:14573 --key-file flight.key --out flight
  dmrac onboard --vehicle "serial:///dev/ttyUSB0?baud=921600" --offboard 127.0.0.1:14573 --controller pid
  dmrac config figure8_wind > flight.yaml
  dmrac onboard --config flight.yaml --out flight
  dmrac onboard --config flight.yaml --vehicle udp://192.168.3.1:14560 --bind-vehicle 192.168.3.2:14561 \\
      --vehicle-key-file vehicle.key --offboard 10.0.0.7:14573 --bind-link 10.0.0.2:14571 --key-file flight.key
"""
OPTIONS: Final = {
    "vehicle": "--vehicle",
    "radio_onboard": "--offboard",
    "ground": "--ground",
    "onboard_vehicle": "--bind-vehicle",
    "onboard_link": "--bind-link",
    "key_file": "--key-file",
    "vehicle_key_file": "--vehicle-key-file",
    "ground_key_file": "--ground-key-file",
}
"""The option that overrides each key of the configuration's `network` section."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `python -m onboard` and `dmrac onboard`."""
    add_flight_options(parser)
    parser.add_argument(
        "--preflight",
        type=Path,
        metavar="FILE",
        help="certificate that dmrac preflight wrote for this vehicle (default: in this folder)",
    )
    parser.add_argument(
        "--no-preflight",
        action="store_true",
        help="arm without a certificate (a simulated vehicle elsewhere)",
    )
    parser.add_argument("--out", type=Path, default=Path(), help="folder for log and summary (default: here)")
    parser.add_argument("--vehicle", metavar="URL", help="the vehicle: udp://HOST:PORT or serial:///dev/ttyX?baud=N")
    parser.add_argument("--offboard", metavar="HOST:PORT", help="the offboard process, or the radio in front of it")
    parser.add_argument("--ground", metavar="HOST:PORT", help="ground station that gets telemetry")
    parser.add_argument("--bind-vehicle", metavar="HOST:PORT", help="own address towards the vehicle")
    parser.add_argument("--bind-link", metavar="HOST:PORT", help="own address towards offboard")
    parser.add_argument("--key-file", metavar="FILE", help="key shared with offboard")
    parser.add_argument("--vehicle-key-file", metavar="FILE", help="key of the vehicle's MAVLink: sign it")
    parser.add_argument("--ground-key-file", metavar="FILE", help="key of the ground station's MAVLink: sign it")
    parser.add_argument("--json", action="store_true", help="status as JSON lines, for a supervising program")


def run(arguments: argparse.Namespace) -> int:
    """Run the process; returns the exit status.

    0 flown, 1 ended by failures or its record is incomplete, 2 bad configuration or address.
    """
    stop = StopRequest()
    try:
        needed = {"--vehicle": "URL", "--offboard": "HOST:PORT"}
        flight = flight_of(arguments, OPTIONS, needed, seen_from_onboard)
        network = flight.network
        status = StatusLines("onboard", arguments.json, network.insecure_links)
        config = fill_process(OnboardConfig, flight.tree, flight.source, "onboard")
        keys = load_keys(network.key_file, network.vehicle_key_file, network.ground_key_file)
        session = session_number(time.time_ns(), secrets.randbits(20))
        clearance = clearance_of(arguments, network.vehicle, config)
        core = OnboardCore(config, session, keys.offboard, keys.vehicle, keys.ground, clearance)
        make_folder(arguments.out)
        sockets = Sockets(network)
    except (ConfigError, StartError) as error:
        print(error, file=sys.stderr)
        return 2
    attachments = {"config.yaml": flight.text}
    about = {
        "seed": str(config.seed),
        "session": str(session),
        "keyed": str(keys.any),
        "insecure": network.insecure_links,
    }
    about |= {"arming_bar": clearance.refusal, "notice": clearance.notice}
    log = FlightLogWriter(arguments.out / "onboard.mcap", "onboard", about, attachments, on_failure=status.fault)
    try:
        status.report("; ".join(map(str, request_realtime(config.realtime.priority))))
        prepare_interpreter()
        status.report(f"vehicle {network.vehicle}, offboard {network.radio_onboard}, ground station {network.ground}")
        if clearance.refusal:
            status.report(f"will not arm: {clearance.refusal}")
        status.report("ready")
        process = OnboardProcess(core, config.realtime, config.period_ns, sockets, log, status, stop)
        result = process.fly()
    finally:
        log.close()
        sockets.close()
    summary = process.summary() | {"log_failure": log.failure}
    written = write_last(arguments.out / "onboard_summary.json", summary)
    return result or int(not written or bool(log.failure))


def clearance_of(arguments: argparse.Namespace, vehicle: str, config: OnboardConfig) -> Clearance:
    """Whether the vehicle has a valid preflight certificate. A vehicle on this machine is simulated and needs none.

    Raises
    ------
    ConfigError
        If two options contradict each other, or the file is not a certificate.
    """
    if arguments.no_preflight and arguments.preflight is not None:
        raise ConfigError("--no-preflight: cannot be used with --preflight")
    if arguments.no_preflight:
        return Clearance(notice="PREFLIGHT OVERRIDDEN (--no-preflight): this vehicle was not checked")
    if is_loopback(vehicle) and arguments.preflight is None:
        return Clearance()
    if config.supervisor.auto_arm:
        return Clearance("auto_arm is for simulation: use dmrac config --real")
    path = arguments.preflight or Path(certificate_name(vehicle))
    try:
        certificate = read_certificate(path.read_bytes(), str(path))
    except FileNotFoundError:
        return Clearance(f"no {path.name}: run dmrac preflight --vehicle {vehicle_url(vehicle)}")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None
    return Clearance(arming_refusal(certificate, vehicle, config.supervisor.arm_needs_pose, time.time()))
