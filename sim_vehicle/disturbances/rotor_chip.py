from collections.abc import Iterable
from typing import Final, Literal

import numpy as np
from numpy.random import Generator
from pydantic import Field

import sim_vehicle.physics.layout as at
from protocol.conventions import Array
from sim_vehicle.world.interface import Condition, Disturbance

RAW_SHAKING: Final = ((0.0, 0.135, 0.24, 0.33, 1.0), (0.0, 31.0, 58.0, 82.0, 250.0))
"""Lost share of the thrust, and raw acceleration of the imbalance at hover speed, m/s^2.

Blade-element estimate for 10, 20 and 30 % of the radius of one blade; proportional beyond.
"""


class RotorChip(Disturbance):
    """A rotor loses part of its blades: less thrust and torque, and an imbalance that shakes the IMU."""

    rotor: Literal[1, 2, 3, 4, "random"] = Field(default="random", description="PX4 motor number")
    thrust_factor: float = Field(gt=0.0, le=1.0, description="share of the thrust that is left")
    torque_factor: float | None = Field(
        default=None, gt=0.0, le=1.0, description="drag torque left; left out: thrust_factor^1.1, slightly lower"
    )
    mount_transmission: float = Field(
        default=0.15, ge=0.0, le=1.0, description="share of the raw shaking that reaches the accelerometer (0.05-0.3)"
    )
    gyroscope_rad_s_per_m_s2: float = Field(
        default=0.0026, ge=0.0, description="(rad/s)/(m/s^2) from raw shaking to the gyro (0.15 rad/s at 58 m/s^2)"
    )

    def draw(self, rng: Generator) -> Array:
        """[1] index of the rotor."""
        drawn = int(rng.integers(4))
        return np.array([float(drawn if self.rotor == "random" else self.rotor - 1)])

    def change(self, condition: Condition, drawn: Array) -> None:
        """Reduce thrust and torque of the rotor, and add its shaking."""
        rotor = int(drawn[0])
        torque_factor = self.thrust_factor**1.1 if self.torque_factor is None else self.torque_factor
        condition.parameters[at.THRUST_FACTOR + rotor] *= self.thrust_factor
        condition.parameters[at.TORQUE_FACTOR + rotor] *= torque_factor
        raw = float(np.interp(1.0 - self.thrust_factor, *RAW_SHAKING))
        condition.shaking[rotor] += raw * self.mount_transmission, raw * self.gyroscope_rad_s_per_m_s2


def chipped_rotors(disturbances: Iterable[tuple[Disturbance, Array]]) -> tuple[int, ...]:
    """PX4 numbers of the damaged rotors. disturbances: of a World, each with what it drew."""
    return tuple(int(drawn[0]) + 1 for one, drawn in disturbances if isinstance(one, RotorChip))
