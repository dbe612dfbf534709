"""What onboard believes of the airframe: nominal mass, inertia and motors, the mixer, and the actuator model.

The simulated (or real) vehicle differs from these numbers; the difference is part of the disturbance Delta.
Motor order is PX4 quad-X: 1 front right (CCW), 2 rear left (CCW), 3 front left (CW), 4 rear right (CW).
"""

from math import exp
from typing import Annotated, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from configs.loader import Record

Array = NDArray[np.float64]
Positive = Annotated[float, Field(gt=0)]
Thrusts = tuple[float, float, float, float]
"""N, motor by motor."""

GRAVITY: Final = 9.81
"""m/s^2."""


class AirframeConfig(Record):
    """Nominal values; sources stand beside the numbers in configs/onboard.yaml."""

    mass_kg: Positive
    inertia_kg_m2: tuple[Positive, Positive, Positive]
    """Jxx, Jyy, Jzz about the body axes."""
    arm_x_m: Positive
    arm_y_m: Positive
    yaw_torque_per_thrust_m: Positive
    motor_thrust_max_n: Positive
    motor_thrust_min_share: Annotated[float, Field(ge=0, lt=0.5)]
    """Idle thrust while armed, as a share of the maximum."""
    motor_lag_up_s: Positive
    motor_lag_down_s: Positive
    motor_response_s: Positive
    """Time constant that the motors are driven to; a lag that is no longer is left as it is."""


class Mixer:
    """Shares collective thrust and torque out to four motors, giving up yaw first, then thrust, then roll and pitch."""

    def __init__(self, config: AirframeConfig) -> None:
        self._config = config
        self._max = config.motor_thrust_max_n
        self._min = config.motor_thrust_min_share * self._max
        self._x = 0.25 / config.arm_x_m
        self._y = 0.25 / config.arm_y_m
        self._z = 0.25 / config.yaw_torque_per_thrust_m

    def thrusts(self, thrust_n: float, torque_nm: tuple[float, float, float]) -> Thrusts:
        """Motor thrusts [N] that come nearest to the demand within [min, max].

        Roll torque is -sum(y_i T_i), pitch torque sum(x_i T_i), yaw torque k (T_1 + T_2 - T_3 - T_4).
        """
        low, high = self._min, self._max
        roll, pitch, yaw = torque_nm[0] * self._y, torque_nm[1] * self._x, torque_nm[2] * self._z
        # Roll and pitch first: shrink them together only if their own spread exceeds the range.
        spread = 2.0 * (abs(roll) + abs(pitch))
        if spread > high - low:
            roll *= (high - low) / spread
            pitch *= (high - low) / spread
        # Roll and pitch part motors 1, 2 by +-first and motors 3, 4 by +-second; yaw raises one pair, lowers the other.
        first, second = pitch - roll, pitch + roll
        raised, lowered = abs(first), abs(second)
        if yaw < 0.0:
            raised, lowered = lowered, raised
        turn, middle = abs(yaw), 0.5 * (raised + lowered)
        # The mean thrust for which some part of the yaw, from none to all, keeps every motor within its limits.
        lowest = max(low + lowered, low + raised - turn, low + middle)
        highest = min(high - raised, high - lowered + turn, high - middle)
        base = min(max(0.25 * thrust_n, lowest), highest)
        turn = max(min(turn, high - base - raised, base - lowered - low), 0.0)
        if yaw < 0.0:
            turn = -turn
        return base + first + turn, base - first + turn, base + second - turn, base - second - turn

    def falls_short(self, thrusts: Thrusts, thrust_n: float, torque_nm: tuple[float, float, float]) -> bool:
        """Whether `thrusts` give up part of the demand: thrust, roll or pitch (yaw alone does not count)."""
        thrust, roll, pitch, _ = wrench(self._config, thrusts)
        return abs(thrust - thrust_n) > 1e-3 or abs(roll - torque_nm[0]) > 1e-5 or abs(pitch - torque_nm[1]) > 1e-5


def wrench(config: AirframeConfig, thrusts: Thrusts) -> tuple[float, float, float, float]:
    """Collective thrust [N] and body torque [N m] of four motors."""
    t1, t2, t3, t4 = thrusts
    return (
        t1 + t2 + t3 + t4,
        config.arm_y_m * (t2 + t3 - t1 - t4),
        config.arm_x_m * (t1 + t3 - t2 - t4),
        config.yaw_torque_per_thrust_m * (t1 + t2 - t3 - t4),
    )


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
