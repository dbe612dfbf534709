"""Measures the still start and the vibration level from IMU samples, before the filter uses them."""

import math
from typing import Final

from protocol.conventions import GRAVITY
from protocol.geometry import Vector3
from protocol.mavlink.vehicle import ImuReading

AXES: Final = "xyz"
"""Names of the body axes in messages."""
_CORNER: Final = 0.2
"""Weight of a sample in the low-pass that the high-pass subtracts: corner at 8 Hz for 200 samples a second."""
_SMOOTHING_S: Final = 0.15
_FORCE_ERROR_MAX: Final = 3.0
"""m/s^2; the specific force of a still vehicle differs from gravity by less than this."""


class StillStart:
    """Means over still samples in a row."""

    def __init__(self, samples: int, rate_max_rad_s: float) -> None:
        self._samples = samples
        self._rate_max = rate_max_rad_s
        self._sums = [0.0] * 6
        self._count = 0

    def add(self, reading: ImuReading) -> bool:
        """Add a sample; True once there are enough. A sample that is not still starts the count again."""
        norm = math.sqrt(sum(a * a for a in reading.accelerometer))
        still = max(map(abs, reading.gyroscope)) < self._rate_max and abs(norm - GRAVITY) < _FORCE_ERROR_MAX
        if not still:
            self._sums, self._count = [0.0] * 6, 0
            return False
        for index, value in enumerate(reading.accelerometer + reading.gyroscope):
            self._sums[index] += value
        self._count += 1
        return self._count >= self._samples

    def level(self) -> tuple[float, float]:
        """Roll and pitch, rad, at which gravity gives the mean specific force."""
        ax, ay, az = self._sums[:3]
        return math.atan2(-ay, -az), math.atan2(ax, math.hypot(ay, az))

    def mean_rate(self) -> Vector3:
        """Mean of the gyroscope, rad/s: its bias, since the vehicle is at rest."""
        x, y, z = (value / self._count for value in self._sums[3:])
        return (x, y, z)


class VibrationMeter:
    """Magnitude of the high-passed accelerometer, smoothed over about 0.15 s, m/s^2."""

    def __init__(self) -> None:
        self._low: Vector3 | None = None
        self._level = 0.0

    def update(self, accelerometer: Vector3, dt: float) -> float:
        """Add a sample; returns the vibration level."""
        ax, ay, az = accelerometer
        lx, ly, lz = self._low or accelerometer
        hx, hy, hz = ax - lx, ay - ly, az - lz
        self._low = (lx + _CORNER * hx, ly + _CORNER * hy, lz + _CORNER * hz)
        magnitude = (1.0 - _CORNER) * math.sqrt(hx * hx + hy * hy + hz * hz)
        self._level += (magnitude - self._level) * dt / (_SMOOTHING_S + dt)
        return self._level
