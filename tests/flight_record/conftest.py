from pathlib import Path

import numpy as np
import pytest

from flight_record.schema import RecordType, vector_fields
from flight_record.writer import FlightLogWriter

TICK = RecordType("onboard/tick", (*vector_fields("position", "ned", "m"), ("mode", "FlightMode, a number")))
TRUTH = RecordType("sim_vehicle/truth", vector_fields("position", "ned", "m"))


@pytest.fixture
def flight_folder(tmp_path: Path) -> Path:
    """A short flight of two processes with an event each and some raw bytes."""
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
