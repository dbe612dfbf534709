"""How much the position loop may ask for: acceleration up and down, tilt, and less of both while the motors fall short.

The limits are on what the loop asks for; what nu_ad makes up for (weak motors, a payload) comes on top vertically.

A motor that has lost thrust holds the attitude with little to spare. A position loop that then asks for a wide tilt
and a hard climb spends what is left: the attitude is lost, and with it the vehicle. So while the mixer has to give up
thrust, roll or pitch, the loop asks for little tilt and climb, and gets its limits back gradually after.

Until the laws adapt, above the floor, nothing makes up for motors weaker than believed or a vehicle heavier: a take-off
may ask for more climb, or it would not lift.
"""

from math import tan
from typing import Annotated

from pydantic import Field

from configs.loader import ConfigRecord
from onboard.control.airframe import GRAVITY
from protocol.geometry import Vector3

FALL_MIN_M_S2 = 2.0
"""Specific thrust never falls below this: without thrust there is no torque and no direction to tilt to."""


class DemandLimitsConfig(ConfigRecord):
    """The limits with motors that deliver, and with motors that fall short."""

    tilt_max_rad: Annotated[float, Field(gt=0, le=1.2)] = 0.7
    climb_acceleration_max_m_s2: Annotated[float, Field(gt=0, le=20)] = 2.0
    take_off_acceleration_max_m_s2: Annotated[
        float, Field(gt=0, le=20, description="climb until the laws begin to adapt")
    ] = 5.0
    sink_acceleration_max_m_s2: Annotated[float, Field(gt=0, le=9)] = 5.0
    short_tilt_max_rad: Annotated[
        float, Field(gt=0, le=1.2, description="tilt while the motors fall short; tilt_max_rad or more: no difference")
    ] = 0.15
    short_climb_max_m_s2: Annotated[float, Field(gt=0, le=20, description="climb while the motors fall short")] = 1.0
    short_after_s: Annotated[float, Field(gt=0, le=10, description="time constant of the limits' falling")] = 0.05
    recovered_after_s: Annotated[float, Field(gt=0, le=60, description="time constant of their coming back")] = 1.0


class DemandLimits:
    """The limits as they are at present."""

    def __init__(self, config: DemandLimitsConfig) -> None:
        self._config = config
        self._tilts = tan(config.tilt_max_rad), min(tan(config.short_tilt_max_rad), tan(config.tilt_max_rad))
        climb = config.climb_acceleration_max_m_s2
        self._climbs = climb, min(config.short_climb_max_m_s2, climb)
        self._lifted = False
        self.shortage = 0.0
        """0: the motors have delivered what was asked for a while; 1: they have fallen short for a while."""

    def step(self, saturated: bool, adapting: bool, dt: float) -> None:
        """Takes note of a tick: whether the mixer gave up part of the demand, and whether the laws adapted."""
        self._lifted = self._lifted or adapting
        if saturated:
            self.shortage += (1.0 - self.shortage) * min(dt / self._config.short_after_s, 1.0)
        else:
            self.shortage -= self.shortage * min(dt / self._config.recovered_after_s, 1.0)

    def reset(self) -> None:
        """As at the beginning of a flight."""
        self.shortage = 0.0
        self._lifted = False

    def specific_thrust(self, u: Vector3, nu_z: float) -> Vector3:
        """The specific thrust to hold up, m/s^2 (world NED, negated), for the acceleration u within the limits.

        nu_z: nu_ad along the vertical, part of u, which the vertical limits leave alone.
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
