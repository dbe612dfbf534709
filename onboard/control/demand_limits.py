"""Limits of the position loop: vertical acceleration and tilt.

The limits apply to the demand of the loop. What the thrust lacks (weak motors, a payload) is added on top: the vertical
part of nu_ad, or the lack of thrust that is measured here, whichever is more.

The lack is the vertical residual, low-passed: how much more of the vehicle's fall is unexplained by the motors than in
the model. On the floor, which carries part of the weight, it is T / m - g, less than the true lack. So a vehicle that
stays on the floor at its limit is allowed ever more thrust until it lifts off or the motors are at their maximum.

The limits are the same while the motors saturate. Lower ones then would save thrust, but they step the commanded
attitude at the moment when there is least torque, and bring vehicles with little thrust into a swing that they do not
leave (docs/findings.md).

Before the laws adapt, nothing compensates motors that are weaker, or a vehicle that is heavier, than the nominal ones.
So take-off has a higher climb limit: most such vehicles lift off without delay.
"""

from math import hypot, tan
from typing import Annotated

from pydantic import Field

from configs.loader import ConfigRecord
from protocol.conventions import GRAVITY
from protocol.geometry import Vector3

FALL_MIN_M_S2 = 2.0
"""Lower limit of the specific thrust: without thrust there is no torque, and tilt has no effect."""
ASTRAY_COSINE = 0.96, 0.90
"""Cosine of the angle between the vehicle's axis and the wanted thrust (16, 26 degrees): where the height begins to
count instead of the projection, and where it alone counts."""
UPRIGHT_MIN = 0.5
"""Cosine of the tilt up to which thrust makes up for it, 60 degrees. Beyond, it has little effect on the height, and
fades to nothing at 90 degrees."""


class DemandLimitsConfig(ConfigRecord):
    """The limits."""

    tilt_max_rad: Annotated[float, Field(gt=0, le=1.2)] = 0.7
    climb_acceleration_max_m_s2: Annotated[float, Field(gt=0, le=20)] = 2.0
    take_off_acceleration_max_m_s2: Annotated[
        float, Field(gt=0, le=20, description="climb until the laws begin to adapt")
    ] = 5.0
    sink_acceleration_max_m_s2: Annotated[float, Field(gt=0, le=9)] = 5.0
    lack_filter_s: Annotated[
        float, Field(gt=0, le=10, description="s, time constant on the vertical residual that tells what thrust lacks")
    ] = 0.2


class DemandLimits:
    """The limits at the present."""

    def __init__(self, config: DemandLimitsConfig) -> None:
        self._config = config
        self._tilt = tan(config.tilt_max_rad)
        self._lifted = False
        self.lack = 0.0
        """What the thrust lacks in vertical acceleration, m/s^2; 0 if it lacks nothing."""

    def step(self, adapting: bool, residual_z: float, dt: float) -> None:
        """Update with one tick.

        adapting: whether the laws adapted. residual_z: vertical acceleration that the delivered thrust does not
        explain, m/s^2, positive downwards.
        """
        self._lifted = self._lifted or adapting
        self.lack = max(0.0, self.lack + (residual_z - self.lack) * min(dt / self._config.lack_filter_s, 1.0))

    def reset(self) -> None:
        """Start over, as at the beginning of a flight."""
        self.lack = 0.0
        self._lifted = False

    def specific_thrust(self, u: Vector3, nu_z: float) -> Vector3:
        """The specific thrust for the acceleration u, within the limits: m/s^2, world NED, negated.

        nu_z: vertical component of nu_ad. It is part of u; the vertical limits do not apply to it. Where more than that
        lacks, the limit of climb does not apply to the lack.
        """
        config = self._config
        climb = config.climb_acceleration_max_m_s2 if self._lifted else config.take_off_acceleration_max_m_s2
        climb += max(self.lack - max(nu_z, 0.0), 0.0)
        ux, uy, uz = u
        uz = min(max(uz + nu_z, -climb), config.sink_acceleration_max_m_s2) - nu_z
        fx, fy, fz = -ux, -uy, max(GRAVITY - uz, FALL_MIN_M_S2)
        horizontal = (fx * fx + fy * fy) ** 0.5
        most = fz * self._tilt
        if horizontal > most:
            fx, fy = fx * most / horizontal, fy * most / horizontal
        return fx, fy, fz


def thrust_along(f: Vector3, axis: Vector3) -> float:
    """Specific thrust [m/s^2] along the vehicle's axis for the wanted specific thrust f; `axis` [3] is a unit vector.

    f' axis where the two agree: it moves the vehicle as much as it can towards f. A vehicle that is tilted far from f
    would sink with that, because less than the vertical part of f is left. There the thrust is such that its vertical
    part is that of f: height before position, as with the angle boost of ArduPilot and the tilt compensation of PX4.
    """
    fx, fy, fz = f
    x, y, z = axis
    along = fx * x + fy * y + fz * z
    begin, end = ASTRAY_COSINE
    cosine = along / hypot(fx, fy, fz)
    if cosine >= begin or z <= 0.0:
        return max(along, 0.0)
    upright = fz / z if z > UPRIGHT_MIN else fz * z / UPRIGHT_MIN**2
    share = min((begin - cosine) / (begin - end), 1.0)
    return max(along + share * max(upright - along, 0.0), 0.0)
