"""A wind model of RotorPy as a disturbance. Only the physics `rotorpy` has it (sim_vehicle/physics/rotorpy_physics.py).

RotorPy's wind objects are Python, which the compiled `act` cannot call. So the physics evaluates them before each
sub-step and writes the air velocity into the disturbance's memory, which `act` adds to the air.
"""

from typing import Any, ClassVar

import sim_vehicle.physics.layout as at
from protocol.conventions import Array
from protocol.geometry import Vector3
from sim_vehicle.world.interface import Disturbance


class RotorpyWind(Disturbance):
    """Base of the winds of RotorPy. RotorPy's world has north, west, up as its axes, and its origin at `place`."""

    stage: ClassVar[int] = at.MEAN_AIR

    def profile(self) -> Any:
        """RotorPy's wind object, which has `update(t, position)`. Raises ImportError without RotorPy."""
        raise NotImplementedError

    @property
    def place(self) -> Vector3:
        """m, NED, the origin of RotorPy's world."""
        return (0.0, 0.0, 0.0)

    def start(self, normals: Array) -> tuple[float, ...]:
        """[3] air velocity, m/s NED."""
        return (0.0, 0.0, 0.0)

    @staticmethod
    def act(v: Array, memory: Array, time_s: float, state: Array, P: Array, noise: Array, effect: Array) -> None:
        """Add the air velocity."""
        for i in range(3):
            effect[at.AIR + i] += memory[i]
