from typing import Any

import numpy as np
from pydantic import Field

from protocol.geometry import Vector3
from sim_vehicle.physics.parameters import UnitVector3
from sim_vehicle.world.rotorpy_wind import RotorpyWind


class RotorpySinusoid(RotorpyWind):
    """RotorPy's SinusoidWind: amplitude * sin(2 pi f (t + phase)) on each axis, everywhere. Needs physics rotorpy.

    t is the time since the onset.
    """

    amplitude_ned_m_s: Vector3 = Field(description="m/s")
    frequency_ned_hz: UnitVector3 = Field(description="Hz")
    phase_ned_s: Vector3 = Field(default=(0.0, 0.0, 0.0), description="s")

    def profile(self) -> Any:
        """RotorPy's SinusoidWind."""
        from rotorpy.wind.default_winds import SinusoidWind

        amplitudes = np.array(self.amplitude_ned_m_s) * (1.0, -1.0, -1.0)
        return SinusoidWind(amplitudes, np.array(self.frequency_ned_hz), np.array(self.phase_ned_s))
