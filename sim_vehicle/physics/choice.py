"""The physics of a vehicle, by its name in the configuration."""

from collections.abc import Callable
from typing import TypeAlias

from protocol.conventions import Array
from sim_vehicle.config import SimVehicleConfig
from sim_vehicle.physics.advance import advance
from sim_vehicle.physics.compiled import compiled
from sim_vehicle.physics.crash import check_crash
from sim_vehicle.physics.disturb import for_disturbances
from sim_vehicle.physics.mujoco_physics import MujocoPhysics
from sim_vehicle.physics.rotorpy_physics import RotorpyPhysics

Physics: TypeAlias = Callable[..., int]
"""Called as `advance_and_check`, for one vehicle."""


def physics_of(config: SimVehicleConfig) -> Physics:
    """What advances a vehicle by several sub-steps. Raises ConfigError as MujocoPhysics and RotorpyPhysics do."""
    if config.physics == "mujoco":
        return _and_check(MujocoPhysics(config))
    if config.physics == "rotorpy":
        return _and_check(RotorpyPhysics(config))
    return for_disturbances(advance_and_check, config.disturbances)


def _and_check(other: MujocoPhysics | RotorpyPhysics) -> Physics:
    def advanced(
        state: Array,
        commands: Array,
        P: Array,
        rows: Array,
        memories: Array,
        noise: Array,
        sums: Array,
        work: Array,
        time_s: float,
        count: int,
        limits: Array,
    ) -> int:
        other(state, commands, P, rows, memories, noise, sums, work, time_s, count)
        return check_crash(state, sums, limits)

    return advanced


@compiled
def advance_and_check(
    state: Array,
    commands: Array,
    P: Array,
    rows: Array,
    memories: Array,
    noise: Array,
    sums: Array,
    work: Array,
    time_s: float,
    count: int,
    limits: Array,
) -> int:
    """`advance`, then `check_crash`, whose result it returns: one call from Python for both."""
    advance(state, commands, P, rows, memories, noise, sums, work, time_s, count)
    return check_crash(state, sums, limits)
