from math import sqrt
from typing import Any

import numpy as np
from pydantic import Field, field_validator

from protocol.geometry import Vector3
from sim_vehicle.world.rotorpy_wind import RotorpyWind


class RotorpyTunnel(RotorpyWind):
    """RotorPy's WindTunnel: a cylinder of moving air without ends, with a sharp edge. Needs physics rotorpy."""

    origin_ned_m: Vector3 = Field(description="m, any point of the cylinder's axis")
    direction_ned: Vector3 = Field(description="of axis and wind; any length but zero")
    radius_m: float = Field(gt=0.0, description="m")
    speed_m_s: float = Field(ge=0.0, description="m/s")

    @field_validator("direction_ned")
    @classmethod
    def _has_length(cls, direction: Vector3) -> Vector3:
        if sum(x * x for x in direction) < 1e-12:
            raise ValueError("has no length")
        return direction

    @property
    def place(self) -> Vector3:
        """m, NED, the origin of RotorPy's world: its tunnel goes through it."""
        return self.origin_ned_m

    def profile(self) -> Any:
        """RotorPy's WindTunnel."""
        from rotorpy.wind.spatial_winds import WindTunnel

        north, east, down = self.direction_ned
        axis = np.array([north, -east, -down]) / sqrt(north * north + east * east + down * down)
        return WindTunnel(self.speed_m_s, axis, self.radius_m)
