"""The onboard process: the core between its sockets, the clock and the log. One loop of four verbs.

    wait -> take in -> step -> give out

Whatever escapes the core's step is answered by the safe motor command, logged and counted; a bounded number of
escapes ends the flight with the motors off. The first SIGINT or SIGTERM asks the core to land, the second ends at
once.
"""

import argparse
import contextlib
import secrets
import sys
import time
import traceback
from pathlib import Path
from typing import Any, Final

import numpy as np

from configs.loader import ConfigError, fill_section
from configs.network import NetworkConfig, is_loopback, seen_from_onboard, serial_line
from configs.realtime import RealtimeConfig
from flight_record.schema import CLOCK_OFFSET, RecordType
from flight_record.writer import FlightLogWriter
from onboard.config import OnboardConfig
from onboard.core import OnboardCore, OnboardOutput
from onboard.frame_stream import FrameStream
from onboard.preflight_record import Clearance, objection, read_record, record_name, vehicle_url
from onboard.realtime import DurationStatistics, PaceKeeper
from onboard.tape import TOPIC, Entry, TapeWriter
from onboard.tick_record import TICK
from protocol.endpoint import DATAGRAMS_PER_STEP_MAX
from protocol.keys import load_keys
from protocol.session import session_number
from shell.errors import StartError
from shell.files import make_folder, write_json
from shell.flight_options import add_flight_options, flight_of
from shell.kernel import ask_for_realtime, quiet_interpreter, resident_mb
from shell.serial_port import SerialPort
from shell.signals import StopRequest
from shell.sockets import AddressInUseError, DatagramSocket
from shell.status import StatusLines

VEHICLE_DATAGRAMS_PER_TICK: Final = 16
GROUND_DATAGRAMS_PER_TICK: Final = 4
VEHICLE_SILENT_NS: Final = 500_000_000
"""A vehicle that has said nothing for so long is not waited for when the process is asked to end."""
FINAL_SAFE_COMMANDS: Final = 3
"""The last command is repeated: one datagram can be lost."""

LOOP: Final = RecordType("onboard/loop", (("lateness", "us"), ("tick", "us"), ("missed", "")))


class Sockets:
    """The three addresses onboard talks to."""

    def __init__(self, network: NetworkConfig) -> None:
        ground_host = network.ground.rpartition(":")[0]
        own_host = "127.0.0.1" if ground_host in {"127.0.0.1", "localhost"} else "0.0.0.0"
        self.vehicle = open_vehicle(network.vehicle, network.onboard_vehicle)
        try:
            self.offboard = DatagramSocket("--bind-link", network.onboard_link, network.radio_onboard)
            self.ground = DatagramSocket("--ground", f"{own_host}:0", network.ground)
        except AddressInUseError:
            self.vehicle.close()
            raise

    def close(self) -> None:
        """Free the addresses."""
        for one in (self.vehicle, self.offboard, self.ground):
            one.close()


def open_vehicle(vehicle: str, local: str, option: str = "--bind-vehicle") -> DatagramSocket | SerialPort:
    """The wire to the vehicle: a socket bound to `local` (given by `option`), or the serial line of its address.

    Raises
    ------
    StartError
        If it cannot be opened.
    """
    line = serial_line(vehicle)
    if line is None:
        return DatagramSocket(option, local, vehicle)
    return SerialPort("--vehicle", line.device, line.baud, FrameStream().feed)


class OnboardProcess:
    """The loop around a core; owns nothing that decides how to fly."""

    def __init__(
        self,
        core: OnboardCore,
        realtime: RealtimeConfig,
        period_ns: int,
        sockets: Sockets,
        log: FlightLogWriter,
        status: StatusLines,
        stop: StopRequest,
    ) -> None:
        self._core = core
        self._realtime = realtime
        self._sockets = sockets
        self._log = log
        self._status = status
        self._stop = stop
        self._pace = PaceKeeper(period_ns, realtime.spin_us * 1000, time.monotonic_ns() + period_ns)
        self._ticks = DurationStatistics()
        self._lateness = DurationStatistics()
        self._loop_record = np.zeros(len(LOOP.fields))
        self._tape = TapeWriter()
        self._last_vehicle_ns = 0
        self._landing_until_ns = 0
        self._latest_report = ""
        self.escapes = 0

    def fly(self) -> int:
        """Run until asked to end; returns the exit status: 0, or 1 if too many steps failed."""
        now = time.monotonic_ns()
        while not self._ended(now):
            now = self._pace.wait()
            output: OnboardOutput | None
            escapes = self.escapes
            try:
                self._take_in(now)
                output = self._core.step(now, missed_ticks=self._pace.missed)
            except Exception:
                output = self._answer_escape(now)
            if output is not None:
                self._give_out(output, now)
            self._log.write_bytes(TOPIC, now, self._tape.end_tick(now, self._pace.missed, self.escapes > escapes))
            self._note_loop(now)
        self._leave_safe(now)
        return int(self.escapes >= self._realtime.escapes_max)

    def _take_in(self, now: int) -> None:
        datagrams = self._sockets.vehicle.receive(VEHICLE_DATAGRAMS_PER_TICK)
        if datagrams:
            self._last_vehicle_ns = now
        for datagram in datagrams:
            self._tape.put(Entry.FROM_VEHICLE, datagram)
            self._core.take_in_vehicle(datagram, now)
        for datagram in self._sockets.offboard.receive(DATAGRAMS_PER_STEP_MAX):
            self._tape.put(Entry.FROM_OFFBOARD, datagram)
            self._core.take_in_offboard(datagram, now)
        for datagram in self._sockets.ground.receive(GROUND_DATAGRAMS_PER_TICK):
            self._tape.put(Entry.FROM_GROUND, datagram)
            self._core.take_in_ground(datagram, now)

    def _give_out(self, output: OnboardOutput, now: int) -> None:
        for datagram in output.to_vehicle:
            self._sockets.vehicle.send(datagram)
            self._tape.put(Entry.TO_VEHICLE, datagram)
        for datagram in output.to_offboard:
            self._sockets.offboard.send(datagram)
            self._tape.put(Entry.TO_OFFBOARD, datagram)
        for datagram in output.to_ground:
            self._sockets.ground.send(datagram)
            self._tape.put(Entry.TO_GROUND, datagram)
        self._log.write(TICK, now, output.tick)
        if output.clock_offset is not None:
            self._log.write(CLOCK_OFFSET, now, output.clock_offset)
        for time_ns, text in output.events:
            self._log.event(time_ns, text)
            self._status.say(text)
        if self._status.due(now):
            self._status.write({**self._core.status(now), "missed_ticks": self._pace.missed, "escapes": self.escapes})

    def _note_loop(self, now: int) -> None:
        duration_ns = time.monotonic_ns() - now
        self._ticks.add(duration_ns)
        self._lateness.add(self._pace.lateness_ns)
        record = self._loop_record
        record[0] = self._pace.lateness_ns * 1e-3
        record[1] = duration_ns * 1e-3
        record[2] = self._pace.missed
        self._log.write(LOOP, now, record)

    def _answer_escape(self, now: int) -> OnboardOutput | None:
        """Log what escaped a step; the safe output, or None if even that fails (the vehicle then cuts its motors)."""
        self.escapes += 1
        report = traceback.format_exc()
        if report != self._latest_report:
            self._latest_report = report
            self._log.event(now, report)
            print(report, file=sys.stderr, flush=True)
        self._status.say(f"a step failed ({self.escapes} of {self._realtime.escapes_max}): {_last_line(report)}")
        with contextlib.suppress(Exception):
            return self._core.safe_output(now)
        return None

    def _ended(self, now: int) -> bool:
        """Whether to leave the loop; asks the core to land when first told to end."""
        if self.escapes >= self._realtime.escapes_max or self._stop.count >= 2:
            return True
        if self._stop.count == 0:
            return False
        if self._landing_until_ns == 0:
            self._landing_until_ns = now + round(self._realtime.landing_limit_s * 1e9)
            self._tape.land_request(now)
            self._core.request_land(now)
        silent = now - self._last_vehicle_ns > VEHICLE_SILENT_NS
        return silent or now > self._landing_until_ns or not self._core.airborne

    def _leave_safe(self, now: int) -> None:
        for _ in range(FINAL_SAFE_COMMANDS):
            with contextlib.suppress(Exception):
                for datagram in self._core.safe_output(now).to_vehicle:
                    self._sockets.vehicle.send(datagram)

    def summary(self) -> dict[str, Any]:
        """What the flight record keeps of this process."""
        return {
            **self._core.summary(),
            "ticks": self._pace.ticks,
            "missed": self._pace.missed,
            "tick_us": self._ticks.summary(),
            "lateness_us": self._lateness.summary(),
            "escapes": self.escapes,
            "rss_mb": round(resident_mb(), 1),
        }


EXAMPLES: Final = """examples:
  dmrac onboard --vehicle udp://192.168.3.1:14560 --offboard 10.0.0.7:14573 --key-file flight.key --out flight
  dmrac onboard --vehicle "serial:///dev/ttyUSB0?baud=921600" --offboard 127.0.0.1:14573 --controller pid
  dmrac config figure8_wind > flight.yaml
  dmrac onboard --config flight.yaml --out flight
  dmrac onboard --config flight.yaml --vehicle udp://192.168.3.1:14560 --bind-vehicle 192.168.3.2:14561 \\
      --offboard 10.0.0.7:14573 --bind-link 10.0.0.2:14571 --key-file flight.key
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
"""What overrules which key of the configuration's network."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `python -m onboard` and `dmrac onboard`."""
    add_flight_options(parser)
    parser.add_argument(
        "--preflight",
        type=Path,
        metavar="FILE",
        help="what dmrac preflight wrote of this vehicle (default: here)",
    )
    parser.add_argument(
        "--no-preflight", action="store_true", help="arm without that record, as a simulated vehicle elsewhere may be"
    )
    parser.add_argument("--out", type=Path, default=Path(), help="folder for log and summary (default: here)")
    parser.add_argument("--vehicle", metavar="URL", help="the vehicle: udp://HOST:PORT or serial:///dev/ttyX?baud=N")
    parser.add_argument("--offboard", metavar="HOST:PORT", help="the offboard process, or the radio towards it")
    parser.add_argument("--ground", metavar="HOST:PORT", help="ground station that gets telemetry")
    parser.add_argument("--bind-vehicle", metavar="HOST:PORT", help="own address towards the vehicle")
    parser.add_argument("--bind-link", metavar="HOST:PORT", help="own address towards offboard")
    parser.add_argument("--key-file", metavar="FILE", help="key shared with offboard")
    parser.add_argument("--vehicle-key-file", metavar="FILE", help="key of the vehicle's MAVLink: sign it")
    parser.add_argument("--ground-key-file", metavar="FILE", help="key of the ground station's MAVLink: sign it")
    parser.add_argument("--json", action="store_true", help="status as JSON lines, for a supervising program")


def run(arguments: argparse.Namespace) -> int:
    """Run the process; returns the exit status (0 flown, 1 ended by failures, 2 bad configuration or address)."""
    stop = StopRequest()
    status = StatusLines("onboard", arguments.json)
    try:
        needed = {"--vehicle": "URL", "--offboard": "HOST:PORT"}
        flight = flight_of(arguments, OPTIONS, needed, seen_from_onboard)
        network = flight.network
        config = fill_section(OnboardConfig, flight.tree, flight.source, "onboard")
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
    about = {"seed": str(config.seed), "session": str(session), "keyed": str(keys.any)}
    about |= {"arming_bar": clearance.bar, "notice": clearance.notice}
    log = FlightLogWriter(arguments.out / "onboard.mcap", "onboard", about, attachments)
    try:
        status.say("; ".join(map(str, ask_for_realtime(config.realtime.priority))))
        quiet_interpreter()
        status.say(f"vehicle {network.vehicle}, offboard {network.radio_onboard}, ground station {network.ground}")
        if clearance.bar:
            status.say(f"will not arm: {clearance.bar}")
        status.say("ready")
        process = OnboardProcess(core, config.realtime, config.period_ns, sockets, log, status, stop)
        result = process.fly()
    finally:
        log.close()
        sockets.close()
    write_json(arguments.out / "onboard_summary.json", process.summary())
    return result


def clearance_of(arguments: argparse.Namespace, vehicle: str, config: OnboardConfig) -> Clearance:
    """Whether a person has done the preflight check of the vehicle. One on this machine is simulated and needs none.

    Raises
    ------
    ConfigError
        If two options contradict each other, or the file is no record.
    """
    if arguments.no_preflight and arguments.preflight is not None:
        raise ConfigError("--no-preflight: not beside --preflight")
    if arguments.no_preflight:
        return Clearance(notice="PREFLIGHT OVERRIDDEN (--no-preflight): nobody vouches for this vehicle")
    if is_loopback(vehicle) and arguments.preflight is None:
        return Clearance()
    if config.supervisor.auto_arm:
        return Clearance("auto_arm is for simulation: use dmrac config --real")
    path = arguments.preflight or Path(record_name(vehicle))
    try:
        record = read_record(path.read_bytes(), str(path))
    except FileNotFoundError:
        return Clearance(f"no {path.name}: run dmrac preflight --vehicle {vehicle_url(vehicle)}")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None
    return Clearance(objection(record, vehicle, config.supervisor.arm_needs_pose, time.time()))


def _last_line(report: str) -> str:
    return report.strip().splitlines()[-1]
