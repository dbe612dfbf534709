"""A full disk ends the log of a flight, with a message, and not the flight."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from configs.addresses import ADDRESSES
from experiments.flights.scenario import Choices, resolve
from flight_log.reader import open_flight
from tests.experiments.processes import Processes

DURATION_S = 8.0
LIMIT_BYTES = 200_000
"""About two seconds of onboard's log."""

pytestmark = pytest.mark.skipif(shutil.which("prlimit") is None, reason="no prlimit on this machine")


def test_fly_says_what_the_record_lacks_and_ends_with_status_1(tmp_path: Path) -> None:
    out = tmp_path / "flight"
    words = ("fly", "hover", "--controller", "pid", "--lockstep", "--duration", "6", "--out", str(out))
    command = ["prlimit", "--fsize=60000", sys.executable, "-m", "async_dmrac", *words]
    result = subprocess.run(command, capture_output=True, text=True, check=False, env={**os.environ, "COLUMNS": "200"})
    assert result.returncode == 1
    assert "Traceback" not in result.stdout + result.stderr
    assert "vehicle alive" in result.stdout
    assert "onboard: File too large" in result.stdout
    lines = [line for line in result.stderr.splitlines() if "the flight log stopped after" in line]
    assert sorted(line.rpartition("/")[2] for line in lines) == [
        "onboard.mcap: File too large",
        "sim_vehicle.mcap: File too large",
    ]
    flight = open_flight(out)
    assert 0.5 < flight.duration_s < 6.5
    assert flight.summary["survived"]


@pytest.mark.full
@pytest.mark.realtime
def test_the_flight_goes_on(tmp_path: Path) -> None:
    names = ADDRESSES
    addresses = tuple(f"network.{name}=127.0.0.1:{16760 + index}" for index, name in enumerate(names))
    config = resolve("hover", Choices("pid", 1, DURATION_S, addresses))
    path = tmp_path / "config.yaml"
    path.write_text(config.to_yaml(), encoding="utf-8")
    with Processes(tmp_path) as processes:
        processes.start("sim", path)
        processes.start("offboard", path)
        processes.start("onboard", path, prefix=("prlimit", f"--fsize={LIMIT_BYTES}"))
        assert processes.wait("sim", 60.0) == 0
        processes.end("onboard", "offboard")
        assert processes.running["onboard"].returncode == 1, "its record is incomplete"
    output = (tmp_path / "onboard_output.txt").read_text(encoding="utf-8")
    assert len(re.findall(r"the flight log stopped after \d\.\d s, the flight goes on", output)) == 1
    assert "Traceback" not in output
    assert processes.summary("sim")["survived"]
    assert processes.summary("onboard")["escapes"] == 0
    flight = open_flight(tmp_path)
    assert 0.5 < (flight["onboard/tick"].time_ns[-1] - flight.start_ns) * 1e-9 < DURATION_S - 2.0
    assert (flight["sim_vehicle/truth"].time_ns[-1] - flight.start_ns) * 1e-9 > DURATION_S - 0.5
    assert any(fault.startswith("onboard.mcap: not closed") for fault in flight.faults)
