"""A real ground station, MAVProxy, attached to a flying simulation: it sees the vehicle, arms it, flies it, lands it.

MAVProxy is a tool of this test only. It is installed without its heavy optional dependencies into pytest's cache, the
first time, which needs a package index.
"""

import contextlib
import io
import os
import selectors
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from async_dmrac.command_line import main
from experiments.flights.scenario import Choices, resolve, with_pose_wait
from onboard.core import OnboardCore
from onboard.flight.supervisor import FlightMode
from sim_vehicle.link.radio import Radio
from sim_vehicle.lockstep import Lockstep
from sim_vehicle.vehicle import SimVehicle

PACKAGES = ("MAVProxy==1.8.75", "pyserial==3.5", "setuptools==80.9.0")
PATIENCE = 8
"""Factor of the time limits: on a machine with other work the simulation is slower than real time."""
BY_HAND = (
    "onboard.supervisor.auto_arm=false",
    "onboard.supervisor.armed_max_s=60",
    "onboard.guidance.land_after_s=300",
)


@pytest.fixture(scope="module")
def mavproxy(request):
    """Folder with MAVProxy."""
    folder = Path(request.config.cache.mkdir("mavproxy")) / "1.8.75"
    if not (folder / "MAVProxy").is_dir():
        command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", str(folder), *PACKAGES]
        result = subprocess.run(command, capture_output=True, text=True, timeout=240, check=False)
        if result.returncode:
            last = (result.stderr.strip().splitlines() or ["pip failed"])[-1]
            pytest.skip(f"MAVProxy cannot be installed: {last}")
    return folder


def mode_file():
    """What `dmrac modes --mavproxy` prints."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        assert main(["modes", "--mavproxy"]) == 0
    return printed.getvalue()


class GroundStation:
    """MAVProxy as a child process, with keyboard and screen."""

    def __init__(self, folder, directory):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        (directory / ".pymavlink").mkdir()
        (directory / ".pymavlink" / "custom_mode_map.json").write_text(mode_file(), encoding="utf-8")
        self.wire = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.wire.connect(("127.0.0.1", port))
        self.wire.setblocking(False)
        arguments = [
            *("--master", f"udpin:127.0.0.1:{port}", "--mav20", "--no-state", "--nowait"),
            *("--default-modules", "cmdlong,arm,mode,ftp,param,battery", "--dialect", "common"),
        ]
        environment = {**os.environ, "PYTHONPATH": str(folder), "PYTHONUNBUFFERED": "1", "HOME": str(directory)}
        self.process = subprocess.Popen(
            [sys.executable, "-W", "ignore", str(folder / "bin" / "mavproxy.py"), *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            cwd=directory,
            env=environment,
        )
        os.set_blocking(self.process.stdout.fileno(), False)
        self.selector = selectors.DefaultSelector()
        self.selector.register(self.process.stdout, selectors.EVENT_READ)
        self.screen = ""

    def type(self, line):
        self.process.stdin.write(line.encode() + b"\n")
        self.process.stdin.flush()

    def look(self):
        if self.selector.select(0):
            self.screen += (self.process.stdout.read() or b"").decode(errors="replace")
        return self.screen

    def receive(self):
        try:
            return self.wire.recv(2048)
        except (BlockingIOError, ConnectionRefusedError):
            return None

    def send(self, datagram):
        with contextlib.suppress(ConnectionRefusedError):  # MAVProxy is not listening yet
            self.wire.send(datagram)

    def close(self):
        self.selector.close()
        self.process.stdin.close()
        self.process.terminate()
        self.process.wait(10)
        self.process.stdout.close()
        self.wire.close()


class PacedFlight:
    """The lockstep simulation without offboard, in real time."""

    def __init__(self, station):
        config = with_pose_wait(resolve("hover", Choices(controller="pid", seed=1, assignments=BY_HAND)))
        self.core = OnboardCore(config.onboard, 1, None)
        radio = Radio(config.radio, np.random.default_rng(1))
        vehicle = SimVehicle(config.vehicle, 1)
        tick, self.from_ground = self.core.tick, []
        self.core.tick = lambda *inputs: tick(*inputs, from_ground=self.from_ground)
        self.lockstep = Lockstep(vehicle, radio, self.core, None, config.onboard.period_ns, 0)
        self.station = station
        self.modes = []
        self.next_s = time.monotonic()

    def until(self, condition, seconds):
        """Fly until the condition is true; fails with MAVProxy's screen after the time limit."""
        end_s = time.monotonic() + PATIENCE * seconds
        while time.monotonic() < end_s:
            result = self.lockstep.step()
            self.from_ground.clear()
            assert not self.lockstep.crash_reason
            self.modes.append(FlightMode(int(result.onboard.tick[0])))
            for datagram in result.onboard.to_ground:
                self.station.send(datagram)
            while (datagram := self.station.receive()) is not None:
                self.from_ground.append(datagram)
            screen = self.station.look()
            if condition(self.modes[-1], screen):
                return
            self.next_s = max(self.next_s + 0.005, time.monotonic() - 0.05)
            time.sleep(max(0.0, self.next_s - time.monotonic()))
        pytest.fail(f"not in {seconds} s; mode {self.modes[-1].name}; MAVProxy says:\n{self.station.look()}")


@pytest.mark.full
@pytest.mark.realtime
def test_mavproxy_sees_arms_flies_and_lands_the_vehicle(mavproxy, tmp_path):
    station = GroundStation(mavproxy, tmp_path)
    try:
        flight = PacedFlight(station)
        flight.until(lambda mode, screen: "online system 1" in screen, 30)
        flight.until(lambda mode, screen: mode is FlightMode.READY, 10)
        flight.until(lambda mode, screen: "Mode READY" in screen, 10)
        station.type("status ATTITUDE_QUATERNION")
        flight.until(lambda mode, screen: "q1" in screen, 10)
        station.type("takeoff 1")  # refused, with a reason
        flight.until(lambda mode, screen: "TEMPORARILY_REJECTED" in screen, 10)
        assert FlightMode.ARMED not in flight.modes
        station.type("arm throttle")
        flight.until(lambda mode, screen: "ARMED" in screen and mode is FlightMode.ARMED, 10)
        station.type("takeoff 1")
        flight.until(lambda mode, screen: mode is FlightMode.FLYING, 15)
        flight.until(lambda mode, screen: "Mode FLYING" in screen, 10)
        station.type("status LOCAL_POSITION_NED")
        flight.until(lambda mode, screen: "LOCAL_POSITION_NED {" in screen, 10)
        station.type("disarm")
        flight.until(lambda mode, screen: "refused to disarm" in screen, 10)
        assert flight.modes[-1] is FlightMode.FLYING
        station.type("long NAV_LAND")
        flight.until(lambda mode, screen: mode is FlightMode.LANDED, 20)
        flight.until(lambda mode, screen: "DISARMED" in screen, 10)
        assert "fence breach" not in station.screen.lower()
        assert "Traceback" not in station.screen
    finally:
        station.close()
