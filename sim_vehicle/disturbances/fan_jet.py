from math import exp, sqrt
from typing import ClassVar

from pydantic import Field, model_validator

import sim_vehicle.physics.layout as at
from protocol.conventions import Array
from protocol.geometry import Vector3
from sim_vehicle.world.interface import Disturbance

HALF_WIDTH_GROWTH = 0.11
"""Half-width of a round turbulent jet per metre from the nozzle (Pope, Turbulent Flows, section 5.1: 0.094-0.11)."""
CENTRE_LINE_DECAY = 6.2
"""Centre-line speed is this times D/x of the nozzle's speed (the same source: 5.8-6.3)."""
LN2 = 0.6931471805599453


class FanJet(Disturbance):
    """A round turbulent jet from a fan: wind that depends on the place."""

    origin_ned_m: Vector3 = Field(description="m, centre of the nozzle")
    direction_ned: Vector3 = Field(description="any length but zero")
    diameter_m: float = Field(gt=0.0, description="m, nozzle")
    speed_m_s: float = Field(ge=0.0, description="m/s at the nozzle")

    stage: ClassVar[int] = at.MEAN_AIR

    @model_validator(mode="after")
    def _has_direction(self) -> "FanJet":
        if sum(x * x for x in self.direction_ned) < 1e-12:
            raise ValueError("direction_ned has no length")
        return self

    def values(self) -> tuple[float, ...]:
        """[8] position of the nozzle (3) m, unit direction (3), diameter m, speed m/s at the nozzle."""
        length = sqrt(sum(x * x for x in self.direction_ned))
        return (*self.origin_ned_m, *(x / length for x in self.direction_ned), self.diameter_m, self.speed_m_s)

    @staticmethod
    def act(v: Array, memory: Array, time_s: float, state: Array, P: Array, noise: Array, effect: Array) -> None:
        """Add the jet's velocity at the vehicle to the air.

        The profile is Gaussian. On the centre line the speed is constant in the potential core, then 6.2 D/x. The
        half-width is D/2 near the nozzle, then 0.11 x. Upstream of the nozzle the air is still.
        """
        rn, re, rd = state[0] - v[0], state[1] - v[1], state[2] - v[2]
        x = rn * v[3] + re * v[4] + rd * v[5]
        if x <= 0.0:
            return
        across = max(0.0, rn * rn + re * re + rd * rd - x * x)
        half_width = max(0.5 * v[6], HALF_WIDTH_GROWTH * x)
        centre = v[7] * min(1.0, CENTRE_LINE_DECAY * v[6] / x)
        speed = centre * exp(-LN2 * across / (half_width * half_width))
        for i in range(3):
            effect[at.AIR + i] += speed * v[3 + i]
