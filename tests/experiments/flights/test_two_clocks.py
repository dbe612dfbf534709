"""A flight whose offboard process stands on another machine, as far as clocks go: its logs share one time base."""

import os
from pathlib import Path

import numpy as np
import pytest

from experiments.flights import realtime_flight
from experiments.flights.realtime_flight import run
from experiments.flights.scenario import Choices, resolve
from flight_log.log_file import read_log_file
from flight_log.reader import open_flight
from flight_log.schema import CLOCK_OFFSET
from tests.experiments.processes import on_ports

pytestmark = pytest.mark.realtime

DURATION_S = 8.0
AHEAD_NS = 5_000_000_000_000
DRIFT = 20_000
"""The other machine's clock gains one part in this many."""

ANOTHER_MACHINE = f"""
import sys, time
real = time.monotonic_ns
time.monotonic_ns = lambda: (now := real()) + now // {DRIFT} + {AHEAD_NS}
from flight_log import metadata
describe = metadata.describe_process
wrong = {{"clock": "monotonic/another machine", "started_utc": "2020-01-01T00:00:00+00:00"}}
metadata.describe_process = lambda: describe() | wrong
from runtime.entry import main
sys.exit(main("offboard", ""))
"""


def test_logs_of_machines_whose_clocks_differ_align(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "another_machine.py").write_text(ANOTHER_MACHINE, encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join((str(tmp_path), str(Path(__file__).resolve().parents[3]))))
    monkeypatch.setattr(realtime_flight, "MODULES", realtime_flight.MODULES | {"offboard": "another_machine"})
    config = on_ports(resolve("hover", Choices(duration_s=DURATION_S)), 16560)
    config_path = tmp_path / "config.yaml"
    config_path.write_text(config.to_yaml(), encoding="utf-8")
    folder = tmp_path / "flight"
    folder.mkdir()
    result = run(config.network, config_path, DURATION_S, folder)
    assert result.sim is not None
    assert result.sim["survived"], result.sim["crash_reason"]

    flight = open_flight(folder)
    assert flight.faults == ()
    measured = flight[CLOCK_OFFSET.topic]
    assert len(measured) >= DURATION_S - 2
    own_ns = read_log_file(folder / "offboard.mcap").vectors["offboard/link"].times_ns
    true_ns = (own_ns - AHEAD_NS) * DRIFT // (DRIFT + 1)
    error_ns = np.abs(flight["offboard/link"].time_ns - true_ns)
    assert error_ns.max() <= measured["round_trip"].max() / 2 + 2_000_000  # and what the clock drifts meanwhile
