from pydantic import Field

import sim_vehicle.physics.layout as at
from protocol.conventions import Array
from protocol.geometry import Vector3
from sim_vehicle.world.interface import Disturbance


class Wrench(Disturbance):
    """A constant force on the frame, fixed in the world, and a constant torque, fixed in the body."""

    force_ned_n: Vector3 = Field(default=(0.0, 0.0, 0.0), description="N, world NED, at the reference point")
    torque_frd_nm: Vector3 = Field(default=(0.0, 0.0, 0.0), description="N m, body FRD")

    def values(self) -> tuple[float, ...]:
        """[6] force and torque."""
        return (*self.force_ned_n, *self.torque_frd_nm)

    @staticmethod
    def act(v: Array, memory: Array, time_s: float, state: Array, P: Array, noise: Array, effect: Array) -> None:
        """Add force and torque."""
        for i in range(3):
            effect[at.FORCE + i] += v[i]
            effect[at.TORQUE + i] += v[3 + i]
