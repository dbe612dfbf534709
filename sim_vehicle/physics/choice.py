"""The physics of a vehicle, by its name in the configuration."""

from collections.abc import Callable
from typing import TypeAlias

from sim_vehicle.config import SimVehicleConfig
from sim_vehicle.physics.advance import advance
from sim_vehicle.physics.disturb import for_disturbances
from sim_vehicle.physics.mujoco_physics import MujocoPhysics

Physics: TypeAlias = Callable[..., None]
"""Called as sim_vehicle.physics.advance.advance, for one vehicle."""


def physics_of(config: SimVehicleConfig) -> Physics:
    """What advances a vehicle by several sub-steps. Raises ConfigError as MujocoPhysics does."""
    if config.physics == "mujoco":
        return MujocoPhysics(config)
    return for_disturbances(advance, config.disturbances)
