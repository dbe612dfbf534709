"""The battery's gauge."""

from typing import NamedTuple

import numpy as np

import sim_vehicle.physics.layout as at
from protocol.conventions import Array
from sim_vehicle.physics.draws import Draws
from sim_vehicle.physics.packing import COULOMB_PER_MAH
from sim_vehicle.sensors.schedule import Schedule


class BatterySample(NamedTuple):
    """Voltage, current and charge."""

    voltage_v: float
    current_a: float
    used_mah: float
    remaining: float
    """Fraction, 0..1."""


class Battery:
    """The gauge, read once a second. The random stream is [seed, stream]."""

    def __init__(self, noise_v: float, capacity_mah: float, seed: int, stream: int) -> None:
        self._noise_v, self._capacity_mah = noise_v, capacity_mah
        self.schedule = Schedule(1.0)
        self._normals = Draws(np.random.default_rng([seed, stream]).standard_normal)

    def sample(self, state: Array, sums: Array) -> BatterySample:
        """Read the gauge."""
        used_mah = float(state[at.CHARGE_USED]) / COULOMB_PER_MAH
        voltage_v = float(state[at.VOLTAGE]) + self._noise_v * self._normals.take()
        return BatterySample(voltage_v, float(sums[at.CURRENT]), used_mah, 1.0 - used_mah / self._capacity_mah)
