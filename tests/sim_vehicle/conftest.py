"""Fixtures: simulated vehicles, MAVLink frames, and the compiled step alone."""

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from pymavlink.dialects.v20 import common as mavlink

import sim_vehicle.physics.layout as at
from configs.loader import merge
from protocol.conventions import Array
from sim_vehicle.config import SimVehicleConfig, load_vehicle
from sim_vehicle.physics.advance import WORK_ROWS, advance
from sim_vehicle.physics.packing import pack_parameters
from sim_vehicle.vehicle import SimVehicle, initial_state

TICK_NS = 5_000_000
DOCUMENT = Path(__file__).parents[2] / "docs" / "vehicle.md"
IDEAL: dict[str, Any] = {
    "battery": {"full_v": 3.7, "empty_v": 3.7, "resistance_ohm": 0.0, "polarisation_ohm": 0.0},
    "drag": {"linear_n_s_m": 0.0, "quadratic_n_s2_m2": 0.0},
    "floor": {"ground_effect": 0.0},
    "initial": {"position_ned_m": [0.0, 0.0, -3.0]},
    "box_m": 1000.0,
}
"""No air, constant battery voltage, high above the floor."""


@dataclass
class Bench:
    """The arrays of one vehicle, without disturbances and sensors."""

    config: SimVehicleConfig
    step_s: float = 0.001
    state: Array = field(init=False)
    P: Array = field(init=False)
    sums: Array = field(init=False)

    def __post_init__(self) -> None:
        self.state = initial_state(self.config)
        self.P = pack_parameters(self.config, self.step_s)
        self.sums = np.zeros(at.SUMS_SIZE)

    def run(self, commands: Any, seconds: float, function: Callable[..., None] = advance) -> None:
        count = round(seconds / self.step_s)
        rows, row_state, noise = np.zeros((0, at.ROW_VALUES)), np.zeros((0, at.ROW_VALUES)), np.zeros((count, 0, 3))
        work, fractions = np.zeros((WORK_ROWS, at.RIGID)), np.array(commands, dtype=np.float64)
        function(self.state, fractions, self.P, rows, row_state, noise, self.sums, work, 0.0, count)


@pytest.fixture
def bench() -> Callable[..., Bench]:
    def make(over: dict[str, Any] | None = None, name: str = "mambo", step_s: float = 0.001) -> Bench:
        return Bench(load_vehicle(name, merge(IDEAL, over or {})), step_s)

    return make


@pytest.fixture
def vehicle() -> Callable[..., SimVehicle]:
    def make(over: dict[str, Any] | None = None, seed: int = 1, name: str = "mambo") -> SimVehicle:
        return SimVehicle(load_vehicle(name, over), seed)

    return make


@pytest.fixture
def motors() -> Callable[..., bytes]:
    """A HIL_ACTUATOR_CONTROLS frame, by pymavlink."""

    def make(fractions: Any, armed: bool = True, time_us: int = 0) -> bytes:
        controls = [*(float(x) for x in fractions), *([0.0] * (16 - len(fractions)))]
        mode = mavlink.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0
        frame: bytes = mavlink.MAVLink_hil_actuator_controls_message(time_us, controls, mode, 0).pack(
            mavlink.MAVLink(None, 1, 1)
        )
        return frame

    return make


@pytest.fixture
def open_loop(motors: Callable[..., bytes]) -> Callable[..., tuple[Array, list[bytes]]]:
    """Flies with fixed commands. Returns the truths of all ticks of 5 ms, and all datagrams."""

    def fly(
        over: dict[str, Any],
        seed: int,
        seconds: float,
        step_ns: int = TICK_NS,
        commands: Any = (0.55, 0.52, 0.54, 0.51),
    ) -> tuple[Array, list[bytes]]:
        vehicle, truths, sent = SimVehicle(load_vehicle("mambo", over), seed), [], []
        for k in range(round(seconds * 1e9 / TICK_NS)):
            vehicle.receive(motors(commands), k * TICK_NS)
            for now in range(k * TICK_NS + step_ns, (k + 1) * TICK_NS + 1, step_ns):
                output = vehicle.step(now)
                sent += output.to_onboard + output.to_motion_capture
            truths.append(output.truth)
        return np.array(truths), sent

    return fly


@pytest.fixture
def frames() -> Callable[..., list[Any]]:
    """Decodes datagrams by pymavlink's stream parser. A datagram that is not exactly one message fails the test."""

    def decode(datagrams: list[bytes], kind: str = "") -> list[Any]:
        messages = []
        for datagram in datagrams:
            found = mavlink.MAVLink(None).parse_buffer(datagram)
            assert found is not None
            assert len(found) == 1
            messages += found
        return [message for message in messages if not kind or message.get_type() == kind]

    return decode


@pytest.fixture
def tether(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Put the example of docs/vehicle.md on the Python path, in tmp_path. Returns the tree of its disturbance."""
    part = DOCUMENT.read_text(encoding="utf-8").split("<!-- example begins -->")[1].split("<!-- example ends -->")[0]
    [code], [scenario] = (re.findall(rf"```{kind}\n(.*?)```", part, re.DOTALL) for kind in ("python", "yaml"))
    assert sum(bool(line.strip()) for line in code.splitlines()) <= 25
    (tmp_path / "my_tether.py").write_text(code, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    [tree] = yaml.safe_load(scenario)["disturbances"]
    return dict(tree)
