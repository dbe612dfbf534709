"""The mixer: from collective thrust and body torque to four motor thrusts, and back.

Motor order is PX4 quad-X: 1 front right (CCW), 2 rear left (CCW), 3 front left (CW), 4 rear right (CW).
"""

from onboard.control.airframe import AirframeConfig

Thrusts = tuple[float, float, float, float]
"""N, motor by motor."""


class Mixer:
    """Distributes thrust and torque to four motors.

    At the motors' limits it reduces yaw first, then thrust, then roll and pitch. The limits are those of motors that
    give `scale` times the nominal thrust.
    """

    def __init__(self, config: AirframeConfig) -> None:
        self._config = config
        self.scale = 1.0
        self._x = 0.25 / config.arm_x_m
        self._y = 0.25 / config.arm_y_m
        self._z = 0.25 / config.yaw_torque_per_thrust_m

    def thrusts(self, thrust_n: float, torque_nm: tuple[float, float, float]) -> Thrusts:
        """Motor thrusts [N] closest to the demand within [min, max].

        Roll torque is -sum(y_i T_i), pitch torque sum(x_i T_i), yaw torque k (T_1 + T_2 - T_3 - T_4).
        """
        high = self.scale * self._config.motor_thrust_max_n
        low = self._config.motor_thrust_min_share * high
        roll, pitch, yaw = torque_nm[0] * self._y, torque_nm[1] * self._x, torque_nm[2] * self._z
        # Roll and pitch first: shrink them together only if their own spread exceeds the range.
        spread = 2.0 * (abs(roll) + abs(pitch))
        if spread > high - low:
            roll *= (high - low) / spread
            pitch *= (high - low) / spread
        # Roll and pitch separate motors 1, 2 by +-first and 3, 4 by +-second; yaw raises one pair, lowers the other.
        first, second = pitch - roll, pitch + roll
        raised, lowered = abs(first), abs(second)
        if yaw < 0.0:
            raised, lowered = lowered, raised
        turn, middle = abs(yaw), 0.5 * (raised + lowered)
        # The range of mean thrust where some part of the yaw, from none to all, keeps every motor within its limits.
        lowest = max(low + lowered, low + raised - turn, low + middle)
        highest = min(high - raised, high - lowered + turn, high - middle)
        base = min(max(0.25 * thrust_n, lowest), highest)
        turn = max(min(turn, high - base - raised, base - lowered - low), 0.0)
        if yaw < 0.0:
            turn = -turn
        return base + first + turn, base - first + turn, base + second - turn, base - second - turn

    def falls_short(self, thrusts: Thrusts, thrust_n: float, torque_nm: tuple[float, float, float]) -> bool:
        """Whether `thrusts` deliver less than the demand in thrust, roll or pitch (yaw does not count)."""
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
