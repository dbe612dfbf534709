"""Measures how fast the simulated vehicle steps: the rigid body alone, the complete vehicle, and a batch."""

from collections.abc import Callable
from importlib.util import find_spec
from time import perf_counter
from typing import Any, Final

import numpy as np

import sim_vehicle.physics.layout as at
from sim_vehicle.config import load_vehicle
from sim_vehicle.physics.advance import WORK_ROWS, advance
from sim_vehicle.physics.batch import VehicleBatch
from sim_vehicle.physics.packing import pack_parameters
from sim_vehicle.vehicle import SimVehicle, initial_state

WORLD: Final[list[dict[str, Any]]] = [
    {"kind": "gusts", "sigma_m_s": 0.3, "length_scale_m": 0.5},
    {"kind": "wind", "velocity_ned_m_s": [1.0, 0.0, 0.0]},
    {"kind": "cloth"},
    {"kind": "rotor_chip", "thrust_factor": 0.9},
]
HIGH: Final[dict[str, Any]] = {"initial": {"position_ned_m": [0.0, 0.0, -4e4], "hovering": True}, "box_m": 1e9}
"""It does not reach the floor."""
PERIOD_NS: Final = 5_000_000
SUBSTEPS: Final = 5
HOVER: Final = 0.47
"""Fraction of full thrust, about that of hover."""
BATCH: Final = 100


def vehicle_speeds(runs: int = 200) -> dict[str, float]:
    """Return the control steps (200 Hz, five sub-steps of 1 ms) per second of a vehicle: the best of `runs` short runs.

    The best run is the one that the rest of the machine disturbed least.
    """
    step_batch = _batch()
    speeds = {
        "rigid body": _best_rate(_rigid_body(), 100, runs),
        "with world, sensors, frames": _best_rate(_whole_vehicle("own"), 50, runs),
    }
    if find_spec("mujoco") is not None:
        speeds["the same over MuJoCo"] = _best_rate(_whole_vehicle("mujoco"), 50, runs)
    if find_spec("rotorpy") is not None:
        speeds["the same over RotorPy"] = _best_rate(_whole_vehicle("rotorpy"), 5, runs)
    return speeds | {f"in a batch of {BATCH}": BATCH * _best_rate(step_batch, 2, runs)}


def _best_rate(step: Callable[[], object], steps: int, runs: int) -> float:
    """Return the calls per second in the fastest run of `steps` calls, after one call that compiles."""
    step()
    best_s = np.inf
    for _ in range(runs):
        start = perf_counter()
        for _ in range(steps):
            step()
        best_s = min(best_s, perf_counter() - start)
    return float(steps / best_s)


def _rigid_body() -> Callable[[], object]:
    config = load_vehicle("mambo", HIGH)
    state, parameters, sums = initial_state(config), pack_parameters(config), np.zeros(at.SUMS_SIZE)
    work, commands = np.zeros((WORK_ROWS, at.RIGID)), np.full(4, HOVER)
    rows, row_state, noise = np.zeros((0, at.ROW_VALUES)), np.zeros((0, at.ROW_VALUES)), np.zeros((SUBSTEPS, 0, 3))
    return lambda: advance(state, commands, parameters, rows, row_state, noise, sums, work, 0.0, SUBSTEPS)


def _whole_vehicle(physics: str) -> Callable[[], object]:
    over = HIGH | {"disturbances": WORLD, "physics": physics}
    vehicle, ticks = SimVehicle(load_vehicle("mambo", over), 1), iter(range(1, 10**9))
    return lambda: vehicle.step(next(ticks) * PERIOD_NS)


def _batch() -> Callable[[], object]:
    batch, commands = VehicleBatch(load_vehicle("mambo", HIGH), range(BATCH)), np.full((BATCH, 4), HOVER)
    return lambda: batch.step(commands)
