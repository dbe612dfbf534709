"""The room for nu_ad: what the actuators can give in each axis beside what the loop itself needs.

    room = max(share (reach - |need|), least reach)

`need` is the demand of the loop without the law, K_r r - K x. `reach` is what the actuators give at the most:

| axis | reach |
|---|---|
| north, east | g tan(tilt_max): the tilt that the position loop is allowed |
| down | the smaller of T_max / m - g (more thrust) and g - 2 m/s^2 (less) |
| roll, pitch, yaw | torque of motors that keep the present collective thrust, over the inertia |

T_max is that of the motors as the thrust scale knows them. `share` leaves the loop a reserve to answer a wrong nu_ad:
in the attitude channel a wrong torque tumbles the vehicle in a tenth of a second. `least` keeps the law at work while
the loop itself is at its limit.
"""

from math import tan
from typing import Annotated

from pydantic import Field

from configs.loader import ConfigRecord
from onboard.control.airframe import AirframeConfig
from onboard.control.demand_limits import FALL_MIN_M_S2
from protocol.conventions import GRAVITY
from protocol.geometry import Vector3

Share = Annotated[float, Field(gt=0, le=2)]


class RoomConfig(ConfigRecord):
    """Shares of the reach, for the position and the attitude channel."""

    enabled: Annotated[bool, Field(description="false: ablation, nu_ad is bounded by W_max alone")] = True
    share: Annotated[tuple[Share, Share], Field(description="of what the loop leaves")] = (1.0, 0.4)
    least: Annotated[tuple[Share, Share], Field(description="of the reach, whatever the loop needs")] = (0.8, 0.25)


class Room:
    """Bounds of nu_ad, per axis."""

    def __init__(self, config: RoomConfig, airframe: AirframeConfig, tilt_max_rad: float) -> None:
        self._config, self._airframe = config, airframe
        self._level = GRAVITY * tan(tilt_max_rad)

    def position(self, thrust_scale: float, need: Vector3) -> Vector3:
        """Bound of |nu_ad| for each axis, m/s^2, world NED. need: m/s^2."""
        most = 4.0 * thrust_scale * self._airframe.motor_thrust_max_n / self._airframe.mass_kg
        down = max(min(most - GRAVITY, GRAVITY - FALL_MIN_M_S2), 0.0)
        return self._room(0, (self._level, self._level, down), need)

    def attitude(self, thrust_scale: float, thrust_n: float, need: Vector3) -> Vector3:
        """Bound of |nu_ad| for each axis, rad/s^2, body FRD, at a collective thrust, N. need: rad/s^2."""
        airframe = self._airframe
        high = thrust_scale * airframe.motor_thrust_max_n
        low = airframe.motor_thrust_min_share * high
        each = 0.25 * thrust_n
        spread = 4.0 * max(min(each - low, high - each), 0.25 * (high - low))
        Jx, Jy, Jz = airframe.inertia_kg_m2
        reach = spread * airframe.arm_y_m / Jx, spread * airframe.arm_x_m / Jy
        return self._room(1, (*reach, spread * airframe.yaw_torque_per_thrust_m / Jz), need)

    def _room(self, channel: int, reach: Vector3, need: Vector3) -> Vector3:
        share, least = self._config.share[channel], self._config.least[channel]
        (x, y, z), (a, b, c) = reach, need
        return (
            max(share * (x - abs(a)), least * x),
            max(share * (y - abs(b)), least * y),
            max(share * (z - abs(c)), least * z),
        )
