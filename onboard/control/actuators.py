"""The actuator model: the thrust that the motors deliver now, from which u_hat follows."""

from math import exp

import numpy as np

from onboard.control.airframe import AirframeConfig
from onboard.control.mixer import Thrusts, wrench
from protocol.conventions import Array


class ActuatorModel:
    """What the motors deliver by now: first-order lag of the commands, quicker up than down; gives u_hat.

    And what has to be commanded so that they follow quicker than that lag.
    """

    def __init__(self, config: AirframeConfig, period_s: float) -> None:
        self._config = config
        self._up = 1.0 - exp(-period_s / config.motor_lag_up_s)
        self._down = 1.0 - exp(-period_s / config.motor_lag_down_s)
        self._lead_up = max(config.motor_lag_up_s / config.motor_response_s, 1.0) - 1.0
        self._lead_down = max(config.motor_lag_down_s / config.motor_response_s, 1.0) - 1.0
        self._max = config.motor_thrust_max_n
        self._min = config.motor_thrust_min_share * self._max
        self.thrusts: Array = np.zeros(4)
        """[4], N, as estimated at the present."""

    def step(self, commanded: Thrusts) -> None:
        """Advances by one period under the thrusts [N] commanded during it."""
        up, down, thrusts = self._up, self._down, self.thrusts
        for index, now in enumerate(thrusts.tolist()):
            command = commanded[index]
            thrusts[index] = now + (up if command > now else down) * (command - now)

    def overdriven(self, wanted: Thrusts) -> Thrusts:
        """The command [N] that brings the motors to `wanted` with motor_response_s, within their limits.

        T_dot = (command - T)/lag is to be (wanted - T)/response.
        """
        t1, t2, t3, t4 = self.thrusts.tolist()
        w1, w2, w3, w4 = wanted
        return self._driven(t1, w1), self._driven(t2, w2), self._driven(t3, w3), self._driven(t4, w4)

    def _driven(self, now: float, wanted: float) -> float:
        gap = wanted - now
        command = wanted + (self._lead_up if gap > 0.0 else self._lead_down) * gap
        return min(max(command, self._min), self._max)

    def wrench(self) -> tuple[float, float, float, float]:
        """Collective thrust [N] and body torque [N m] as delivered now."""
        return wrench(self._config, self.thrusts.tolist())
