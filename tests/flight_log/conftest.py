import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flight_log.schema import RecordType, vector_fields
from flight_log.writer import FlightLogWriter
from offboard import records as offboard_records
from onboard.record import tick as tick_record
from sim_vehicle import records as sim_records

TICK = RecordType("onboard/tick", (*vector_fields("position", "ned", "m"), ("mode", "FlightMode, a number")))
TRUTH = RecordType("sim_vehicle/truth", vector_fields("position", "ned", "m"))


@pytest.fixture
def flight_folder(tmp_path: Path) -> Path:
    """A short flight of two processes with one event each and some raw bytes."""
    folder = tmp_path / "flight"
    with FlightLogWriter(
        folder / "onboard.mcap", "onboard", {"clock": "a", "seed": "3"}, {"config.yaml": b"a: 1\n"}, threaded=False
    ) as log:
        for i in range(1000):
            log.write(TICK, 10**9 + i * 5_000_000, np.array([0.1 * i, -1e-7, np.nan, 4.0]))
            if i % 100 == 0:
                log.write_bytes("onboard/received", 10**9 + i * 5_000_000, bytes([i // 100]))
        log.event(2 * 10**9, 'took off, "well"')
    with FlightLogWriter(folder / "sim_vehicle.mcap", "sim_vehicle", {"clock": "a"}, threaded=False) as log:
        for i in range(500):
            log.write(TRUTH, 10**9 + i * 10_000_000, np.array([0.2 * i, 0.0, -1.0]))
        log.event(3 * 10**9, "rotor chip")
    return folder


SUMMARY = {
    "scenario": "figure8_wind",
    "controller": "dmrac",
    "seed": 7,
    "mode": "lockstep",
    "duration_s": 20.0,
    "survived": True,
    "crash_reason": "",
    "position_rmse_m": 0.123456,
    "lap_rmse_m": [0.2, 0.1],
    "features": {"version": 3, "swaps": 2, "refused": 0, "age_s_median": None},
    "link": {"up": {"sent": 100, "delivered": 95, "lost": 5}, "rejected": {}},
}


def write_full_flight(folder: Path, *, error_m: float = 0.1, **summary: Any) -> Path:
    """20 s of a circle, with the records that the processes write; onboard takes off after 2 s."""
    config = b"scenario: figure8_wind\nduration_s: 20\n"
    times = [(i, i * 20_000_000, 0.02 * i) for i in range(1000)]
    with FlightLogWriter(
        folder / "onboard.mcap", "onboard", {"clock": "lockstep"}, {"config.yaml": config}, threaded=False
    ) as log:
        for _, time_ns, t in times:
            log.write(tick_record.TICK, time_ns, tick_values(t, error_m))
        log.event(2 * 10**9, "mode FLYING <fast>")
    with FlightLogWriter(
        folder / "sim_vehicle.mcap", "sim_vehicle", {"clock": "lockstep"}, {"config.yaml": config}, threaded=False
    ) as log:
        for _, time_ns, t in times:
            values = dict.fromkeys(sim_records.TRUTH.names, 0.0)
            values |= {"position_n": np.cos(t) + error_m, "position_e": np.sin(t), "position_d": -1.0}
            values |= {
                "quaternion_w": 1.0,
                "airborne": 1.0,
                "wind_n": 4.0,
                "disturbance_force_n": 0.05,
                "motor_thrust_1": 0.17,
            }
            log.write(sim_records.TRUTH, time_ns, np.array(list(values.values())))
    with FlightLogWriter(folder / "offboard.mcap", "offboard", {"clock": "lockstep"}, threaded=False) as log:
        for i in range(60):
            values = dict.fromkeys(offboard_records.TRAINING.names, 0.5 / (i + 1)) | {"round": float(i)}
            log.write(offboard_records.TRAINING, i * 300_000_000, np.array(list(values.values())))
    (folder / "summary.json").write_text(json.dumps({**SUMMARY, **summary}), encoding="utf-8")
    return folder


def tick_values(t: float, error_m: float) -> np.ndarray:
    values = dict.fromkeys(tick_record.TICK.names, 0.0)
    values |= {
        "path_time": max(t - 2.0, 0.0),
        "feature_version": float(t > 5.0),
        "feature_age": t % 3.0 if t > 5 else -1,
    }
    values |= {"position_n": np.cos(t) + error_m, "position_e": np.sin(t), "position_d": -1.0, "quaternion_w": 1.0}
    values |= {"target_n": np.cos(t), "target_e": np.sin(t), "target_d": -1.0, "commanded_quaternion_w": 1.0}
    values |= {
        "position_adaptive_n": 0.3,
        "position_weight_norm": 0.5,
        "position_tracking_bound": 0.2,
        "motor_1": 0.5,
        "motor_thrust_1": 0.16,
    }
    return np.array(list(values.values()))


@pytest.fixture
def full_flight(tmp_path: Path) -> Path:
    """A flight folder as `fly` writes it, with a figure."""
    folder = write_full_flight(tmp_path / "20260101_120000_figure8_wind")
    (folder / "flight.png").write_bytes(b"\x89PNG\r\n\x1a\n of a flight")
    return folder


@pytest.fixture
def make_flight(tmp_path: Path) -> Callable[..., Path]:
    """Writes further flight folders: name, error_m, and summary entries that differ."""
    return lambda name, **options: write_full_flight(tmp_path / name, **options)
