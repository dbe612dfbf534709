"""The actuator model: the thrust that the motors deliver now, from which u_hat follows.

Commands are shares of the maximum thrust. The motors give `scale` times the nominal one
(onboard/control/thrust_scale.py).
"""

from math import exp
from typing import Final, NamedTuple

import numpy as np

from onboard.control.airframe import AirframeConfig
from onboard.control.mixer import Thrusts, wrench
from protocol.conventions import Array
from protocol.geometry import Vector3

Shares = tuple[float, float, float, float]
"""Shares of the maximum thrust, motor by motor."""
CATCH_UP_MAX: Final = 20
"""Missed ticks that are caught up: the vehicle stops its motors after 0.1 s without a command."""


class Delivered(NamedTuple):
    """What the motors deliver at the present."""

    thrusts_n: Array
    """[4], N, motor by motor."""
    thrust_n: float
    """Collective thrust."""
    torque_nm: Vector3
    """Body torque."""


class ActuatorModel:
    """First-order lag from commanded to delivered thrust, faster up than down, and its compensation."""

    def __init__(self, config: AirframeConfig, period_s: float) -> None:
        self._config = config
        self._up = 1.0 - exp(-period_s / config.motor_lag_up_s)
        self._down = 1.0 - exp(-period_s / config.motor_lag_down_s)
        self._lead_up = max(config.motor_lag_up_s / config.motor_response_s, 1.0) - 1.0
        self._lead_down = max(config.motor_lag_down_s / config.motor_response_s, 1.0) - 1.0
        self._min_share = config.motor_thrust_min_share
        self._scale = 1.0
        self._acting: Shares = (0.0, 0.0, 0.0, 0.0)
        self.delivered = Delivered(np.zeros(4), 0.0, (0.0, 0.0, 0.0))

    @property
    def scale(self) -> float:
        """Thrust of the motors as a multiple of the nominal one. With a new one, their shares stay as they are."""
        return self._scale

    @scale.setter
    def scale(self, scale: float) -> None:
        ratio, self._scale = scale / self._scale, scale
        thrusts_n, thrust_n, (roll, pitch, yaw) = self.delivered
        self.delivered = Delivered(ratio * thrusts_n, ratio * thrust_n, (ratio * roll, ratio * pitch, ratio * yaw))

    def step(self, commanded: Shares) -> Delivered:
        """Advance by one period under the shares of the maximum thrust commanded during it."""
        self.delivered = self.ahead(commanded)
        return self.delivered

    def catch_up(self, commanded: Shares, missed: int) -> list[Delivered]:
        """What was delivered at the end of each period since the last tick, the last one now.

        A command acts one tick after it was computed, and until the next one acts. So the command before acted in the
        first period, and the last one in those of the missed ticks.

        Parameters
        ----------
        commanded: shares of the maximum thrust, of the last tick.
        missed: ticks missed since then.
        """
        acting, self._acting = self._acting, commanded
        return [self.step(acting), *(self.step(commanded) for _ in range(missed))]

    def ahead(self, commanded: Shares) -> Delivered:
        """What the motors will deliver one period later under these shares of the maximum thrust; nothing changes."""
        up, down, most = self._up, self._down, self._scale * self._config.motor_thrust_max_n
        each_motor = zip(self.delivered.thrusts_n.tolist(), commanded, strict=True)
        thrusts = [now + (up if most * share > now else down) * (most * share - now) for now, share in each_motor]
        t1, t2, t3, t4 = thrusts
        T, roll, pitch, yaw = wrench(self._config, (t1, t2, t3, t4))
        return Delivered(np.array(thrusts), T, (roll, pitch, yaw))

    def overdriven(self, wanted: Thrusts) -> Shares:
        """The command, in shares, that brings the motors to `wanted` [N] with motor_response_s, within their limits.

        The motors obey T_dot = (command - T) / lag; the command makes that (wanted - T) / response. What it is beyond
        `wanted` is the lead. Near full thrust there is little room upwards: what the leads upwards lack there, those
        downwards do without, by the same share. Otherwise the motors that slow down would outrun those that cannot
        speed up, and every torque would cost thrust.
        """
        most = self._scale * self._config.motor_thrust_max_n
        each_motor = list(zip(self.delivered.thrusts_n.tolist(), wanted, strict=True))
        leads = [(self._lead_up if want > now else self._lead_down) * (want - now) for now, want in each_motor]
        upwards = possible = 0.0
        for want, lead in zip(wanted, leads, strict=True):
            if lead > 0.0:
                upwards += lead
                possible += min(lead, max(most - want, 0.0))
        share = possible / upwards if upwards > 0.0 else 1.0
        commands = (want + (lead if lead > 0.0 else share * lead) for want, lead in zip(wanted, leads, strict=True))
        a, b, c, d = (min(max(command / most, self._min_share), 1.0) for command in commands)
        return a, b, c, d
