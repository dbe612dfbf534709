"""Optical flow camera with its own integrated gyro, in PX4's signs.

Angles are integrated about the body's axes. Turning right-handed about an axis gives positive flow about it, moving
along +y gives negative flow about x, moving along +x gives positive flow about y. With the integrated gyro subtracted,

    v_y = -(flow_x - gyro_x)/dt * distance,    v_x = (flow_y - gyro_y)/dt * distance,

where distance is measured along the body's down axis.
"""

from math import sqrt
from typing import NamedTuple

import numpy as np

import sim_vehicle.physics.layout as at
from protocol.conventions import Array
from sim_vehicle.physics.draws import Draws
from sim_vehicle.physics.parameters import FlowConfig
from sim_vehicle.sensors.schedule import Schedule


class FlowSample(NamedTuple):
    """Integrals over `time_s`, rad."""

    time_s: float
    flow_rad: tuple[float, float]
    gyroscope_rad: tuple[float, float, float]
    quality: int


class Flow:
    """The camera. The random stream is [seed, stream]."""

    def __init__(self, config: FlowConfig, seed: int, stream: int) -> None:
        self._config = config
        self.schedule = Schedule(config.rate_hz)
        self._normals = Draws(np.random.default_rng([seed, stream]).standard_normal)

    def sample(self, state: Array, sums: Array) -> FlowSample:
        """Read the camera and zero the flow's sums."""
        config = self._config
        n1, n2, n3, n4, n5 = self._normals.several(5)
        time, fx, fy, gx, gy, gz = sums[at.FLOW_TIME : at.FLOW_GYRO + 3].tolist()
        sums[at.FLOW_TIME : at.FLOW_GYRO + 3] = 0.0
        noise, gyro_noise = config.noise_rad_s * time, config.gyroscope_noise_rad_s * time
        flow = (fx + noise * n1, fy + noise * n2)
        gyroscope = (gx + gyro_noise * n3, gy + gyro_noise * n4, gz + gyro_noise * n5)
        height = -float(state[at.POSITION + 2])
        rate = sqrt(fx * fx + fy * fy) / time
        sees = config.least_m <= height <= config.greatest_m and rate <= config.rate_limit_rad_s
        return FlowSample(time, flow, gyroscope, config.quality if sees else 0)
