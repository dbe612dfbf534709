from math import exp

from pydantic import Field

import sim_vehicle.physics.layout as at
from protocol.conventions import Array
from sim_vehicle.world.interface import Disturbance


class BatterySag(Disturbance):
    """The voltage falls further than that of a good battery, exponentially towards a drop."""

    drop_v: float = Field(default=0.3, ge=0.0, le=2.0, description="V, in the end")
    time_constant_s: float = Field(default=10.0, gt=0.0, description="s")

    def values(self) -> tuple[float, ...]:
        """[2] drop V, time constant s."""
        return (self.drop_v, self.time_constant_s)

    @staticmethod
    def act(v: Array, memory: Array, time_s: float, state: Array, P: Array, noise: Array, effect: Array) -> None:
        """Add the drop."""
        effect[at.VOLTAGE_DROP] += v[0] * (1.0 - exp(-time_s / v[1]))
