"""docs/real_mambo.md, docs/another_vehicle.md: command and numbers; real processes without the simulated radio."""

import contextlib
import os
import pty
import re
import shlex
import subprocess
import sys
import time
from pathlib import Path

import pytest

from async_dmrac import command_line
from configs.addresses import load_network
from configs.loader import CONFIG_DIRECTORY, read_tree
from experiments.flights.scenario import Choices, resolve
from onboard.links.frame_stream import FrameStream
from onboard.preflight.certificate import AGE_MAX_S, certificate_name
from sim_vehicle.vehicle import SimVehicle
from tests.experiments.processes import ROOT, Processes

PAGE = (ROOT / "docs" / "real_mambo.md").read_text(encoding="utf-8")
WIRE_PAGE = (ROOT / "docs" / "another_vehicle.md").read_text(encoding="utf-8")
PORTS = {
    name: f"127.0.0.1:{17460 + index}"
    for index, name in enumerate(
        ("vehicle", "onboard_vehicle", "radio_onboard", "onboard_link", "radio_offboard", "offboard_link")
    )
}
PORTS |= {"motion_capture": "127.0.0.1:17466", "ground": "127.0.0.1:17467"}


def test_the_pages_command_gives_a_configuration_for_a_real_vehicle(tmp_path, monkeypatch):
    command = re.search(r"dmrac config .*?(?=\n\n)", PAGE, re.DOTALL)
    words = shlex.split(command.group().replace("\\\n", " "))[1:]
    monkeypatch.chdir(tmp_path)
    assert command_line.main(words) == 0
    path = tmp_path / "flight.yaml"
    network = load_network(path, {})
    assert network.radio_onboard == network.offboard_link
    assert network.radio_offboard == network.onboard_link
    supervisor = read_tree(path)["onboard"]["supervisor"]
    assert supervisor == {**supervisor, **read_tree(CONFIG_DIRECTORY / "real_vehicle.yaml")["supervisor"]}
    assert supervisor["auto_arm"] is False


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("imu_silent_s", "IMU | 50 ms"),
        ("tilt_max_rad", "tilt | 1.0 rad"),
        ("pose_stale_s", "pose | 0.5 s"),
        ("hold_max_s", "after 5 s land"),
        ("velocity_lost_s", "pose and flow | 2 s"),
        ("level_max_s", "motors off after 8 s"),
        ("battery_low_v", "battery below 3.3 V or 30 %"),
        ("battery_silent_s", "no report for 5 s"),
        ("battery_arm_v", "below 3.7 V or 30 %"),
        ("ground_silent_s", "ground station | 3 s"),
        ("fence_m", "1.5 m from the origin"),
        ("ceiling_m", "1.8 m high"),
        ("offboard_silent_s", "offboard | 1 s"),
    ],
)
def test_the_pages_limits_are_those_of_the_configuration(name, words):
    assert words in PAGE + WIRE_PAGE
    value = getattr(resolve("hover", Choices(real=True)).onboard.supervisor, name)
    numbers = [float(number) for number in re.findall(r"\d+(?:\.\d+)?", words)]
    assert value in numbers or value * 1000 in numbers


def test_the_page_names_the_certificate_and_its_validity():
    assert certificate_name("192.168.3.1:14560") in WIRE_PAGE
    assert f"{AGE_MAX_S // 3600} hours" in WIRE_PAGE


def config_file(folder: Path, *assignments: str) -> Path:
    own = tuple(f"network.{name}={address}" for name, address in PORTS.items())
    config = resolve("hover", Choices("pid", 1, 12.0, (*own, "onboard.pose_wait_s=1.0", *assignments)))
    path = folder / "flight.yaml"
    path.write_text(config.to_yaml(), encoding="utf-8")
    return path


@contextlib.contextmanager
def punctual():
    """Real-time priority for this process while it plays the vehicle, where that is allowed."""
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))
    try:
        yield
    finally:
        with contextlib.suppress(PermissionError):
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


class SerialVehicle:
    """The simulated vehicle on the far end of a serial line, in real time."""

    def __init__(self, descriptor, config):
        self.descriptor, self.vehicle, self.stream = descriptor, SimVehicle(config, 1), FrameStream()
        self.height, self.commands = 0.0, 0

    def fly(self, seconds):
        start = time.monotonic_ns()
        for tick in range(round(seconds * 200)):
            now = tick * 5_000_000
            time.sleep(max(0.0, (start + now - time.monotonic_ns()) * 1e-9))
            try:
                frames = self.stream.feed(os.read(self.descriptor, 4096))
            except BlockingIOError:
                frames = []
            for frame in frames:
                self.vehicle.receive(frame, now)
                self.commands += 1
            flown = self.vehicle.step(now)
            self.height = -float(flown.truth[2])
            for frame in flown.to_onboard:
                os.write(self.descriptor, frame)


@pytest.mark.full
@pytest.mark.realtime
def test_onboard_flies_a_vehicle_on_a_serial_line(tmp_path):
    patient = "onboard.supervisor.imu_silent_s=0.5"  # here the test itself is the vehicle, and a machine may be busy
    path = config_file(tmp_path, patient)
    far, near = pty.openpty()
    os.set_blocking(far, False)
    vehicle = SerialVehicle(far, resolve("hover", Choices("pid", 1)).vehicle)
    vehicle.vehicle.step(0)  # compiled before the clock runs
    vehicle = SerialVehicle(far, resolve("hover", Choices("pid", 1)).vehicle)
    processes = Processes(tmp_path)
    try:
        url = f"serial://{os.ttyname(near)}?baud=921600"
        processes.start("onboard", path, "--vehicle", url, "--no-preflight")  # nobody has tilted it by hand
        with punctual():
            vehicle.fly(7.0)
        height = vehicle.height
    finally:
        processes.end(*processes.running)
        os.close(far)
        os.close(near)
    assert not vehicle.vehicle.crash_reason
    assert 0.7 < height < 1.3
    assert vehicle.commands > 1000
    assert vehicle.stream.skipped.total() < 100
    assert processes.summary("onboard")["escapes"] == 0


@pytest.mark.full
@pytest.mark.realtime
def test_onboard_and_offboard_fly_without_the_radio_between_them(tmp_path):
    path = config_file(tmp_path)
    processes = Processes(tmp_path)
    try:
        processes.start("sim", path)
        processes.start("offboard", path, "--onboard", PORTS["onboard_link"])
        url = f"udp://{PORTS['vehicle']}"
        processes.start("onboard", path, "--offboard", PORTS["offboard_link"], "--vehicle", url)
        assert processes.wait("sim", 40.0) == 0
    finally:
        processes.end(*processes.running)
    assert processes.summary("sim")["survived"]
    assert processes.summary("sim")["link"]["up"]["sent"] == 0
    assert processes.summary("offboard")["poses_relayed"] > 500
    assert processes.summary("onboard")["estimator"]["pose_used"] > 500


@pytest.mark.full
@pytest.mark.realtime
def test_preflight_listens_to_the_simulated_vehicle(tmp_path):
    path = config_file(tmp_path)
    processes = Processes(tmp_path)
    words = ["--vehicle", f"udp://{PORTS['vehicle']}", "--bind", PORTS["onboard_vehicle"]]
    try:
        processes.start("sim", path)
        command = [sys.executable, "-m", "async_dmrac", "preflight", *words, "--listen-only"]
        command += ["--pose", PORTS["motion_capture"], "--config", str(path)]
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "160"}
        run = {"capture_output": True, "text": True, "timeout": 60, "check": False, "env": environment}
        result = subprocess.run(command, cwd=tmp_path, **run)
    finally:
        processes.end(*processes.running)
    assert result.returncode in (0, 1), result.stderr  # 1: a busy machine, whose jitter is the simulated vehicle's
    failed = {line.split("FAIL")[1].strip() for line in result.stdout.splitlines() if line.startswith("  FAIL")}
    assert failed <= {"IMU jitter", "IMU rate"}
    for row in ("time base", "accelerometer at rest", "battery", "pose upright"):
        assert f"pass {row}" in result.stdout
    assert "not ready to fly" in result.stdout or failed
    assert (tmp_path / certificate_name(PORTS["vehicle"])).is_file()
    assert "will not arm" in result.stdout
