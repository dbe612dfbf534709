from typing import ClassVar

from pydantic import Field

import sim_vehicle.physics.layout as at
from protocol.conventions import Array
from protocol.geometry import Vector3
from sim_vehicle.world.interface import Disturbance


class Wind(Disturbance):
    """The same air velocity everywhere."""

    velocity_ned_m_s: Vector3 = Field(description="m/s, NED, where the air goes")

    stage: ClassVar[int] = at.MEAN_AIR

    def values(self) -> tuple[float, ...]:
        """[3] velocity, m/s NED."""
        return self.velocity_ned_m_s

    @staticmethod
    def act(v: Array, memory: Array, time_s: float, state: Array, P: Array, noise: Array, effect: Array) -> None:
        """Add the velocity to the air."""
        for i in range(3):
            effect[at.AIR + i] += v[i]
