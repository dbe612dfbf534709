"""Limits of the position loop: vertical acceleration and tilt, with lower limits while the motors saturate.

The limits apply to the demand of the loop. The vertical part of nu_ad (weak motors, a payload) is added on top.

After a loss of thrust the motors have little reserve for attitude control. If the position loop then demands a large
tilt and a fast climb, it uses up this reserve and the vehicle crashes. So while the mixer reduces thrust, roll or
pitch, the limits of tilt and climb are low; afterwards they return gradually.

Before the laws adapt, nothing compensates motors that are weaker, or a vehicle that is heavier, than the nominal ones.
So take-off has a higher climb limit: the vehicle would not lift off otherwise.
"""

from math import tan
from typing import Annotated

from pydantic import Field

from configs.loader import ConfigRecord
from protocol.conventions import GRAVITY
from protocol.geometry import Vector3

FALL_MIN_M_S2 = 2.0
"""Lower limit of the specific thrust: without thrust there is no torque, and tilt has no effect."""


class DemandLimitsConfig(ConfigRecord):
    """Limits in normal flight, and while the motors saturate ("short")."""

    tilt_max_rad: Annotated[float, Field(gt=0, le=1.2)] = 0.7
    climb_acceleration_max_m_s2: Annotated[float, Field(gt=0, le=20)] = 2.0
    take_off_acceleration_max_m_s2: Annotated[
        float, Field(gt=0, le=20, description="climb until the laws begin to adapt")
    ] = 5.0
    sink_acceleration_max_m_s2: Annotated[float, Field(gt=0, le=9)] = 5.0
    short_tilt_max_rad: Annotated[
        float, Field(gt=0, le=1.2, description="tilt while the motors saturate, at most tilt_max_rad")
    ] = 0.15
    short_climb_max_m_s2: Annotated[float, Field(gt=0, le=20, description="climb while the motors saturate")] = 1.0
    short_after_s: Annotated[float, Field(gt=0, le=10, description="time constant of lowering the limits")] = 0.05
    recovered_after_s: Annotated[float, Field(gt=0, le=60, description="time constant of raising them again")] = 1.0


class DemandLimits:
    """The limits at the present."""

    def __init__(self, config: DemandLimitsConfig) -> None:
        self._config = config
        self._tilts = tan(config.tilt_max_rad), min(tan(config.short_tilt_max_rad), tan(config.tilt_max_rad))
        climb = config.climb_acceleration_max_m_s2
        self._climbs = climb, min(config.short_climb_max_m_s2, climb)
        self._lifted = False
        self.shortage = 0.0
        """From 0, the motors deliver the demand, to 1, they have saturated for some time."""

    def step(self, saturated: bool, adapting: bool, dt: float) -> None:
        """Update with one tick: whether the mixer reduced the demand, and whether the laws adapted."""
        self._lifted = self._lifted or adapting
        if saturated:
            self.shortage += (1.0 - self.shortage) * min(dt / self._config.short_after_s, 1.0)
        else:
            self.shortage -= self.shortage * min(dt / self._config.recovered_after_s, 1.0)

    def reset(self) -> None:
        """Start over, as at the beginning of a flight."""
        self.shortage = 0.0
        self._lifted = False

    def specific_thrust(self, u: Vector3, nu_z: float) -> Vector3:
        """The specific thrust for the acceleration u, within the limits: m/s^2, world NED, negated.

        nu_z: vertical component of nu_ad. It is part of u; the vertical limits do not apply to it.
        """
        share = self.shortage
        if self._lifted:
            climb = self._climbs[0] + share * (self._climbs[1] - self._climbs[0])
        else:
            climb = self._config.take_off_acceleration_max_m_s2
        ux, uy, uz = u
        uz = min(max(uz + nu_z, -climb), self._config.sink_acceleration_max_m_s2) - nu_z
        fx, fy, fz = -ux, -uy, max(GRAVITY - uz, FALL_MIN_M_S2)
        horizontal = (fx * fx + fy * fy) ** 0.5
        most = fz * (self._tilts[0] + share * (self._tilts[1] - self._tilts[0]))
        if horizontal > most:
            fx, fy = fx * most / horizontal, fy * most / horizontal
        return fx, fy, fz
