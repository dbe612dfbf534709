"""`dmrac preflight`: checks a vehicle's stream, its motion by hand and its motors, and prints a table.

It writes the results to a certificate. `dmrac onboard` arms a vehicle on another machine only with a complete and good
certificate.
"""

import argparse
import select
import time
from collections.abc import Callable, Collection
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from async_dmrac.commands.output import add_json_option, console_for, print_json
from configs.addresses import (
    ONBOARD_VEHICLE_PORT,
    LinkName,
    check_address,
    check_vehicle_address,
    is_loopback,
    keyless_fault,
    load_network,
    own_address,
    serial_line,
)
from configs.loader import ConfigError, read_tree
from experiments.flights.preflight_session import PreflightSession
from offboard.config import PoseRelayConfig
from offboard.links.pose_relay import PoseRelay
from onboard.config import OnboardConfig
from onboard.links.vehicle import VehicleLinkConfig
from onboard.preflight.certificate import arming_refusal, certificate_name, read_certificate, write_certificate
from onboard.preflight.checks import Check, MotorAnswer, PreflightConfig, Result, Step, skipped
from onboard.preflight.recorder import PoseSample, StepRecorder
from onboard.process import open_vehicle
from protocol.feature_config import fill_process
from protocol.keys import load_key
from protocol.mavlink.signing import SigningClock
from runtime.errors import StartError
from runtime.files import write_atomically
from runtime.flight_options import add_insecure_option
from runtime.kernel import request_realtime
from runtime.sockets import DatagramSocket

EXAMPLES = """examples:
  dmrac preflight --vehicle udp://192.168.3.1:14560 --vehicle-key-file vehicle.key \\
      --pose 0.0.0.0:14574 --capture-key-file capture.key
  dmrac preflight --vehicle "serial:///dev/ttyUSB0?baud=921600" --no-motors
  dmrac preflight --vehicle udp://127.0.0.1:14560 --listen-only     # the simulated vehicle of `dmrac sim`
"""
PLACES = {"fr": "front right", "fl": "front left", "rr": "rear right", "rl": "rear left", "none": "none"}
COLOURS = {Result.PASS: "green", Result.FAIL: "bold red", Result.SKIPPED: "yellow", Result.ABSENT: "dim"}
DATAGRAMS_PER_WAKE = 64
PRIORITY = 40
"""FIFO priority, the same as onboard's."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `dmrac preflight`."""
    parser.add_argument("--vehicle", required=True, metavar="URL", help="udp://HOST:PORT or serial:///dev/ttyX?baud=N")
    parser.add_argument(
        "--bind", metavar="HOST:PORT", help=f"own address towards the vehicle (default port {ONBOARD_VEHICLE_PORT})"
    )
    parser.add_argument("--pose", metavar="HOST:PORT", help="own address to which motion capture sends ODOMETRY")
    parser.add_argument("--config", type=Path, help="resolved configuration, for key file and battery limit")
    parser.add_argument("--vehicle-key-file", metavar="FILE", help="key of the vehicle's MAVLink, if it is signed")
    parser.add_argument("--capture-key-file", metavar="FILE", help="key of the motion capture's MAVLink")
    add_insecure_option(parser)
    parser.add_argument(
        "--certificate",
        type=Path,
        metavar="FILE",
        help="file for the results (default: named by the vehicle, in this folder)",
    )
    parser.add_argument("--no-motors", action="store_true", help="do not turn the motors")
    add_json_option(parser, "the checks")
    parser.add_argument("--listen-only", action="store_true", help="check the stream only: no motion, no motors")


def run(arguments: argparse.Namespace) -> int:
    """Run the check; returns 0 if no check failed, else 1. Bad usage (2) is raised."""
    link, config = VehicleLinkConfig(), PreflightConfig()
    key_files = {"vehicle_key_file": arguments.vehicle_key_file, "capture_key_file": arguments.capture_key_file}
    insecure = tuple(arguments.insecure)
    if arguments.config is not None:
        network = load_network(arguments.config, {**key_files, "insecure": insecure})
        key_files, insecure = {name: getattr(network, name) for name in key_files}, network.insecure
        onboard = fill_process(OnboardConfig, read_tree(arguments.config), str(arguments.config), "onboard")
        link = onboard.vehicle_link
        config = config.model_copy(update={"battery_min_v": onboard.supervisor.battery_arm_v})
    key, capture_key = map(load_key, key_files.values())
    file: Path | None = arguments.certificate
    if file is not None and not file.parent.is_dir():  # before the person's work, not after
        raise ConfigError(f"--certificate {file}: there is no folder {file.parent}")
    keyed = {link for link, one in (("vehicle", key), ("motion_capture", capture_key)) if one is not None}
    wire = UdpOrSerialWire(arguments.vehicle, arguments.bind, arguments.pose, keyed | {*insecure}, capture_key)
    request_realtime(PRIORITY)  # or the delay of this process would count as the vehicle's
    console = console_for(arguments)
    recorder = StepRecorder(link, key, SigningClock(utc_at_first_use_ns=time.time_ns()))
    session = PreflightSession(wire, PersonAtTerminal(console), recorder, config, arguments.pose is not None)
    ended = False
    try:
        session.run(motion=not arguments.listen_only, motors=not (arguments.no_motors or arguments.listen_only))
        ended = True
    finally:
        wire.close()
        checks = session.checks if ended else [*session.checks, skipped("the rest", "ended early")]
        if arguments.json:
            print_json([{**check._asdict(), "result": check.result.value} for check in checks])
        else:
            console.print(table_of(checks))
        path = file or Path(certificate_name(wire.vehicle))
        partly = arguments.listen_only or arguments.no_motors
        console.print(
            write_certificate_file(path, wire.vehicle, arguments.pose is not None, checks, partly), soft_wrap=True
        )
    console.print(verdict(checks))
    return int(any(check.result is Result.FAIL for check in checks))


def write_certificate_file(path: Path, vehicle: str, with_pose: bool, checks: list[Check], partly: bool) -> str:
    """Write the certificate for onboard. A partial check without a failure does not replace an earlier certificate.

    Raises
    ------
    StartError
        If the file cannot be written.
    """
    if partly and path.exists() and all(check.result is not Result.FAIL for check in checks):
        return f"{path}: not changed, because not all checks were requested"
    utc_s = int(time.time())
    content = write_certificate(vehicle, utc_s, with_pose, checks)
    try:
        write_atomically(path, content)
    except OSError as error:
        raise StartError(f"--certificate {path}: cannot be written: {error.strerror}") from None
    reason = arming_refusal(read_certificate(content, str(path)), vehicle, True, utc_s)
    return f"{path}: written; {f'dmrac onboard will not arm: {reason}' if reason else 'dmrac onboard will arm'}"


def _require_allowed(link: LinkName, address: str, allowed: Collection[str]) -> None:
    """Raise ConfigError if a link leaves this machine and is not `allowed` to."""
    if link not in allowed and serial_line(address) is None and not is_loopback(address):
        raise ConfigError(keyless_fault(link, address))


class UdpOrSerialWire:
    """The vehicle by UDP or serial line, the motion capture, and the clock."""

    def __init__(
        self, vehicle: str, bind: str | None, pose: str | None, allowed: Collection[str], capture_key: bytes | None
    ) -> None:
        """`allowed`: links that may leave this machine, because they have a key or are said to be insecure.

        Raises ConfigError for an invalid address, StartError for one that cannot be opened.
        """
        self.vehicle = _checked("--vehicle", vehicle, check_vehicle_address)
        local = _checked("--bind", bind or own_address(self.vehicle, ONBOARD_VEHICLE_PORT), check_address)
        pose = None if pose is None else _checked("--pose", pose, check_address)
        _require_allowed("vehicle", self.vehicle, allowed)
        if pose is not None:
            _require_allowed("motion_capture", pose, allowed)
        self._vehicle = open_vehicle(self.vehicle, local, "--bind")
        try:
            self._pose = None if pose is None else DatagramSocket("--pose", pose, None)
        except StartError:
            self._vehicle.close()
            raise
        config = PoseRelayConfig(latency_s=0.0, position_limit_m=1e5)  # so large that mm are recognised
        self._relay = PoseRelay(config, capture_key, SigningClock(utc_at_first_use_ns=time.time_ns()))
        self._sources = [one for one in (self._vehicle, self._pose) if one is not None]

    def now_ns(self) -> int:
        """Monotonic time."""
        return time.monotonic_ns()

    def exchange(self, wait_s: float) -> tuple[list[bytes], list[PoseSample]]:
        """The vehicle's datagrams, and the poses of the motion capture."""
        select.select(self._sources, (), (), wait_s)
        poses = []
        if self._pose is not None:
            for datagram in self._pose.receive(DATAGRAMS_PER_WAKE):
                pose = self._relay.receive(datagram, self.now_ns())
                if pose is not None:
                    n, e, d = pose.position_ned_m.tolist()
                    w, x, y, z = pose.quaternion.tolist()
                    poses.append(PoseSample(pose.time_ns, (n, e, d), (w, x, y, z)))
        return self._vehicle.receive(DATAGRAMS_PER_WAKE), poses

    def send(self, datagram: bytes) -> None:
        """Send one datagram to the vehicle."""
        self._vehicle.send(datagram)

    def close(self) -> None:
        """Close the sockets."""
        for one in self._sources:
            one.close()


class PersonAtTerminal:
    """Asks the person on the terminal."""

    def __init__(self, console: Console) -> None:
        self._console = console

    def ready(self, step: Step, seconds: float) -> None:
        """Explain a step and wait for Enter, except for the first step, which needs nobody."""
        if step is Step.STILL:
            self._console.print(f"Listening for {seconds:.0f} s: {step.value}.")
            return
        self._console.print(f"\nNext, within {seconds:.0f} s of pressing Enter: {step.value}.")
        self._console.print("Hold it still for the first and the last second.")
        self._ask("Enter to begin: ")

    def consents(self) -> bool:
        """Whether the person typed yes."""
        self._console.print(
            "\n[bold red]Motors will turn, one at a time.[/] Take the PROPELLERS OFF, or tie the vehicle"
        )
        self._console.print("down, and keep hands, hair and eyes away.")
        return self._ask('Type "yes" to let the motors turn: ') == "yes"

    def saw(self, motor: int) -> MotorAnswer:
        """Place and direction of the rotor that turned, asked until the answer is valid."""
        place = spin = ""
        while place not in PLACES:
            place = self._ask(f"Motor {motor}: which rotor turned? fr, fl, rr, rl or none: ").lower()
        while place != "none" and spin not in ("cw", "ccw"):
            spin = self._ask("Which way, seen from above? cw or ccw: ").lower()
        return MotorAnswer(PLACES[place], spin)

    def saw_it_stop(self) -> bool:
        """Whether the rotor of the last spin stopped."""
        return self._ask("Did the rotor stop by itself, at once? yes or no: ").lower() == "yes"

    def tell(self, checks: list[Check]) -> None:
        """Print a line for each check."""
        for check in checks:
            colour = COLOURS[check.result]
            self._console.print(f"  [{colour}]{check.result.value}[/] {check.name}", highlight=False)

    def _ask(self, question: str) -> str:
        try:
            return self._console.input(question, markup=False).strip()
        except EOFError:
            raise StartError("preflight asks questions and needs a terminal; --listen-only does not") from None


def table_of(checks: list[Check]) -> Table:
    """The table of all checks, with the most likely cause of each failure."""
    table = Table(title="preflight")
    for heading in ("check", "result", "measured", "wanted", "likely cause"):
        table.add_column(heading, overflow="fold")
    for check in checks:
        colour = COLOURS[check.result]
        table.add_row(
            check.name, f"[{colour}]{check.result.value}[/]", *map(escape, (check.measured, check.wanted, check.hint))
        )
    return table


def verdict(checks: list[Check]) -> str:
    """The line under the table."""
    failed = sum(check.result is Result.FAIL for check in checks)
    left = sum(check.result is Result.SKIPPED for check in checks)
    if failed:
        return f"{failed} of {len(checks)} checks failed: do not fly."
    return f"{left} checks were not done: not ready to fly." if left else "All checks passed."


def _checked(option: str, value: str, check: Callable[[str], str]) -> str:
    """The address of an option in plain form. Raises ConfigError that names the option."""
    try:
        return check(value)
    except ValueError as error:
        raise ConfigError(f"{option} {value}: {error}") from None
