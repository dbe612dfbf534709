"""Two vehicles in the air and one trainer for both, as processes over UDP in real time."""

from pathlib import Path

import pytest

from experiments.flights.scenario import Choices, resolve
from flight_log.reader import open_flight
from tests.experiments.processes import Processes, on_ports

pytestmark = pytest.mark.realtime

DURATION_S = 20.0
AT_ONCE = ("offboard.trainer.minimum_samples=60",)
"""The first version does not wait: a flight is short."""
FLIGHTS = {1: "lissajous_wind", 2: "figure8_wind"}
"""Per vehicle; both in a jet, where a version pays (in a calm hover a slow trainer may have nothing to send)."""


def test_one_trainer_teaches_two_vehicles(tmp_path: Path) -> None:
    """Each vehicle learns from its own samples and has its own files; nothing of one reaches the other."""
    configs, folders = {}, {}
    for number in FLIGHTS:
        choices = Choices(seed=number, duration_s=DURATION_S, vehicle=number, assignments=AT_ONCE)
        config = on_ports(resolve(FLIGHTS[number], choices), 16600 + 20 * number)
        configs[number] = tmp_path / f"{number}.yaml"
        configs[number].write_text(config.to_yaml(), encoding="utf-8")
        folders[number] = tmp_path / f"vehicle_{number}"
        folders[number].mkdir()
    with Processes(tmp_path) as trainer, Processes(folders[1]) as first, Processes(folders[2]) as second:
        trainer.start("offboard", configs[1], "--also", str(configs[2]))
        for number, vehicle in ((1, first), (2, second)):
            vehicle.start("sim", configs[number])
            vehicle.start("onboard", configs[number])
        for vehicle in (first, second):
            assert vehicle.wait("sim", DURATION_S + 30.0) == 0
            vehicle.end("onboard")
        trainer.end("offboard")
        assert trainer.running["offboard"].returncode == 0
        for vehicle in (first, second):
            sim, onboard, offboard = (vehicle.summary(name) for name in ("sim", "onboard", "offboard"))
            assert sim["survived"], sim["crash_reason"]
            assert onboard["features"]["swaps"] >= 1
            assert offboard["rounds"] >= 2
            assert offboard["escapes"] == 0
    for number in FLIGHTS:
        assert (folders[number] / "checkpoint.npz").exists()
        flight = open_flight(folders[number])
        assert flight.faults == ()
        assert {"onboard/tick", "offboard/training"} <= set(flight.topics)
