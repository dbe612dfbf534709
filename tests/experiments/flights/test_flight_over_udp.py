"""Three real processes over real UDP in real time: the flight of a new user, and its failures."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from experiments.flights.realtime_flight import Supervisor
from experiments.flights.scenario import Choices, resolve
from experiments.replays.recorded_flight import read_recorded
from experiments.replays.replay_check import check_flight
from flight_log.reader import open_flight
from onboard.flight.modes import FlightMode
from tests.experiments.processes import on_ports

pytestmark = pytest.mark.realtime

DURATION_S = 15.0
KILL_AT_S = 4.0
RESTART_AT_S = 4.5


class KillAndRestart:
    """Watches the flight's status; kills offboard in the air, and later starts another."""

    def __init__(self, supervisor: Supervisor) -> None:
        self.offboard = supervisor.children
        self.second: subprocess.Popen[bytes] | None = None
        self.killed = False
        self.texts: list[str] = []

    def __call__(self, entry: dict[str, Any]) -> None:
        if entry["kind"] == "event":
            self.texts.append(f"{entry['process']}: {entry['text']}")
        time_s = entry.get("time_s", 0.0)
        child = self.offboard.get("offboard")
        if child is None or entry["process"] != "sim":
            return
        if time_s > KILL_AT_S and not self.killed:
            self.killed = True
            child.process.kill()
        if time_s > RESTART_AT_S and self.second is None:
            self.second = subprocess.Popen(child.command, stdout=subprocess.DEVNULL)


def test_a_flight_survives_the_death_of_offboard_and_uses_another(tmp_path: Path) -> None:
    config = on_ports(resolve("hover", Choices(duration_s=DURATION_S)), 16460)
    config_path = tmp_path / "config.yaml"
    config_path.write_text(config.to_yaml(), encoding="utf-8")
    supervisor = Supervisor(config_path, tmp_path, DURATION_S, lambda entry: observer(entry))
    observer = KillAndRestart(supervisor)
    supervisor.fly()
    assert observer.second is not None
    observer.second.terminate()
    assert observer.second.wait(10.0) == 0

    assert supervisor.result.exit_status == {"sim": 0, "offboard": -9, "onboard": 0}
    assert all(not child.running for child in supervisor.children.values())
    summary = {name: read_summary(tmp_path, name) for name in ("sim", "onboard", "offboard")}
    assert summary["sim"]["survived"], summary["sim"]["crash_reason"]
    assert summary["sim"]["duration_s"] == pytest.approx(DURATION_S, abs=0.01)
    assert summary["onboard"]["escapes"] == 0
    assert summary["onboard"]["ticks"] + summary["onboard"]["missed"] > 0.99 * DURATION_S * 200
    assert summary["onboard"]["missed"] < 0.02 * DURATION_S * 200
    assert "onboard: offboard silent" in observer.texts
    assert "onboard: offboard restarted" in observer.texts
    assert summary["offboard"]["received"] > 0
    assert summary["offboard"]["poses_relayed"] > 0

    flight = open_flight(tmp_path)
    ticks = flight["onboard/tick"]
    modes = set(ticks["mode"].astype(int).tolist())
    assert {FlightMode.TAKE_OFF, FlightMode.FLYING, FlightMode.LANDING, FlightMode.LANDED} <= modes
    assert not modes & {FlightMode.HOLD_LEVEL, FlightMode.EMERGENCY}

    (checked,) = check_flight(read_recorded(tmp_path))  # the golden replay: a new core gives the same outputs
    assert checked.difference is None
    assert checked.incomplete == ""
    assert checked.ticks == checked.rows == summary["onboard"]["ticks"]


def read_summary(folder: Path, name: str) -> dict[str, Any]:
    summary: dict[str, Any] = json.loads((folder / f"{name}_summary.json").read_text(encoding="utf-8"))
    return summary


def test_a_single_process_reports_an_error_in_one_line(tmp_path: Path) -> None:
    config = on_ports(resolve("hover"), 16460).to_yaml()
    path = tmp_path / "config.yaml"
    wrong = {
        "onboard": (config.replace("priority: 40", "priority: 4000"), "onboard.realtime.priority: 4000"),
        "offboard": (config.replace("offboard_link:", "offboard_lnk:"), "network.offboard_lnk: unknown key"),
        "sim_vehicle": (config.replace("seed: 1\n", "seed: one\n", 1), "seed 'one'"),
    }
    for module, (text, expected) in wrong.items():
        path.write_text(text, encoding="utf-8")
        command = [sys.executable, "-m", module, "--config", str(path), "--out", str(tmp_path / "out")]
        environment = {**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[3])}
        result = subprocess.run(command, capture_output=True, text=True, timeout=60, env=environment, check=False)
        assert result.returncode == 2, result.stderr
        assert expected in result.stderr
        assert "Traceback" not in result.stderr
    assert not (tmp_path / "out").exists(), "nothing was started"
