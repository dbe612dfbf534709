"""Height by ultrasound."""

from math import cos

import numpy as np

import sim_vehicle.physics.layout as at
from protocol.conventions import Array
from sim_vehicle.physics.crash import tilt_of
from sim_vehicle.physics.draws import Draws
from sim_vehicle.physics.parameters import UltrasonicConfig
from sim_vehicle.sensors.schedule import Schedule

NO_ECHO_TILT_RAD = 1.0
"""Beyond the half cone: the echo misses the sensor."""


class Ultrasonic:
    """Distance to the floor, with noise and outliers. The random stream is [seed, stream]."""

    def __init__(self, config: UltrasonicConfig, seed: int, stream: int) -> None:
        self._config = config
        self.schedule = Schedule(config.rate_hz)
        rng = np.random.default_rng([seed, stream])
        self._normals, self._uniforms = Draws(rng.standard_normal), Draws(rng.spawn(1)[0].random)

    def sample(self, state: Array) -> float | None:
        """Distance in m along the beam, or None without an echo."""
        config = self._config
        outlier, place = self._uniforms.take(), self._uniforms.take()
        noise = config.noise_m * self._normals.take()
        if outlier < config.outlier_probability:
            return config.least_m + place * (config.greatest_m - config.least_m)
        beyond = max(0.0, tilt_of(state) - config.half_cone_rad)
        if beyond > NO_ECHO_TILT_RAD:
            return None
        distance = -float(state[at.POSITION + 2]) / cos(beyond) + noise
        return None if distance > config.greatest_m else max(config.least_m, distance)
