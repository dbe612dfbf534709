from numpy.random import Generator
from pydantic import Field

import sim_vehicle.physics.layout as at
from protocol.conventions import Array
from sim_vehicle.world.interface import Condition, Disturbance


class MotorGain(Disturbance):
    """Thrust per command differs from the map: a common factor, and a random spread between motors."""

    common: float = Field(default=0.75, gt=0.0, le=1.5, description="really 0.65-0.85")
    spread: float = Field(default=0.1, ge=0.0, lt=1.0, description="half-width of the uniform spread between motors")

    def draw(self, rng: Generator) -> Array:
        """[4] factors of the motors."""
        return self.common * (1.0 + rng.uniform(-self.spread, self.spread, 4))

    def change(self, condition: Condition, drawn: Array) -> None:
        """Multiply the gains."""
        condition.parameters[at.GAIN : at.GAIN + 4] *= drawn
