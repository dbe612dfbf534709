from math import exp, sqrt
from typing import ClassVar

from pydantic import Field

import sim_vehicle.physics.layout as at
from protocol.conventions import Array
from sim_vehicle.world.interface import Disturbance

ADVECTION_MIN_M_S = 0.2
"""Gusts also change for a vehicle that hovers in still air."""


class Gusts(Disturbance):
    """First-order turbulence on each axis: a frozen field that passes the vehicle at its speed through the mean air."""

    sigma_m_s: float = Field(ge=0.0, description="m/s per axis; indoors 0.1-0.2 of the mean wind")
    length_scale_m: float = Field(gt=0.0, description="m; indoors 0.3-1")
    advection_m_s: float | None = Field(
        default=None, gt=0.0, description="m/s; left out: the vehicle's speed through the mean air, at least 0.2"
    )

    stage: ClassVar[int] = at.TURBULENCE

    def values(self) -> tuple[float, ...]:
        """[3] sigma m/s, length scale m, advection speed m/s or -1."""
        return (self.sigma_m_s, self.length_scale_m, -1.0 if self.advection_m_s is None else self.advection_m_s)

    def start(self, normals: Array) -> tuple[float, ...]:
        """[3] gust velocity, m/s NED, from the stationary distribution."""
        return tuple((self.sigma_m_s * normals).tolist())

    @staticmethod
    def act(v: Array, gust: Array, time_s: float, state: Array, P: Array, noise: Array, effect: Array) -> None:
        """Per axis y = a y + sigma sqrt(1 - a^2) n, a = exp(-V dt/L): exact, and of variance sigma^2 at any speed V."""
        speed = v[2] if v[2] >= 0.0 else max(ADVECTION_MIN_M_S, effect[at.AIR_SPEED])
        a = exp(-speed * P[at.STEP] / v[1])
        b = v[0] * sqrt(1.0 - a * a)
        for i in range(3):
            gust[i] = a * gust[i] + b * noise[i]
            effect[at.AIR + i] += gust[i]
