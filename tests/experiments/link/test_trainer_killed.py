"""A real trainer is killed with SIGKILL repeatedly in one real flight; each new one resumes its checkpoint."""

import time
from pathlib import Path

import pytest

from experiments.flights.scenario import Choices, resolve
from experiments.replays.recorded_flight import read_recorded
from experiments.replays.replay_check import check_flight
from onboard.flight.modes import FlightMode
from tests.experiments.processes import Processes, on_ports

pytestmark = [pytest.mark.realtime, pytest.mark.full]

DURATION_S = 45.0
LIVES = 4


def test_the_vehicle_survives_a_trainer_that_is_killed_repeatedly(tmp_path: Path) -> None:
    config = on_ports(resolve("figure8_wind", Choices("dmrac", 2, DURATION_S)), 17760)
    path, checkpoint = tmp_path / "config.yaml", tmp_path / "checkpoint.npz"
    path.write_text(config.to_yaml(), encoding="utf-8")
    with Processes(tmp_path) as processes:
        processes.start("sim", path)
        processes.start("offboard", path)
        processes.start("onboard", path)
        for _ in range(LIVES):
            time.sleep(6.0)
            processes.running["offboard"].kill()
            processes.running["offboard"].wait()
            time.sleep(0.5)
            processes.start("offboard", path, *(("--resume", str(checkpoint)) if checkpoint.exists() else ()))
        assert processes.wait("sim", DURATION_S + 30.0) == 0
        processes.end("onboard", "offboard")
        sim, onboard = processes.summary("sim"), processes.summary("onboard")
    assert sim["survived"], sim["crash_reason"]
    assert onboard["escapes"] == 0
    assert onboard["missed"] <= 0.01 * onboard["ticks"]
    flight = read_recorded(tmp_path)
    assert flight.trace is not None
    modes = set(flight.trace.mode.tolist())
    assert FlightMode.LANDED in modes
    assert not modes & {FlightMode.HOLD_LEVEL, FlightMode.EMERGENCY, FlightMode.TERMINATED}
    assert onboard["features"]["swaps"] >= 1
    assert len(list(tmp_path.glob("offboard*.mcap"))) == LIVES + 1
    (checked,) = check_flight(flight)
    assert checked.difference is None
