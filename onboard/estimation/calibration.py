"""Calibrates the IMU on the bench: means over some seconds at rest, motors off, before the first arming.

Theory of operation. The samples are averaged over blocks of half a second. A block that is not like the mean of those
before it shows that the vehicle moved: the calibration begins again. Enough blocks in a row that agree are a
calibration:

  gyroscope       its bias is the mean rate
  accelerometer   its bias along gravity is the mean's length less g. Across gravity a bias looks like a tilt: only a
                  measured attitude, the pose of a motion capture, separates the two (estimator.py)

A slow turn about the vertical at less than the limit cannot be told from a bias.

An accepted calibration is kept for later flights of the process. While the vehicle rests, the mean rate of each block
is compared with the kept bias. If it is off by more than the limit, somebody carries the vehicle or the bias has
drifted: calibrated again. The specific force is not compared, since a vehicle lands where the floor slopes otherwise.
"""

import math
from typing import Any, Final, NamedTuple

from onboard.estimation.config import EstimatorConfig
from onboard.estimation.imu_conditioning import AXES
from protocol.conventions import GRAVITY
from protocol.geometry import Vector3
from protocol.mavlink.vehicle import ImuReading

BLOCK_S: Final = 0.5
LEAST_SAMPLES: Final = 20
"""A block of fewer samples is not used."""
CALIBRATING: Final = "calibrating the IMU"
MOVED: Final = "the vehicle moved during the calibration of its IMU"


class Calibration(NamedTuple):
    """An accepted calibration."""

    force: Vector3
    """m/s^2, body: mean specific force."""
    rate: Vector3
    """rad/s, body: mean rate, which is the gyroscope's bias."""
    samples: int
    seconds: float

    @property
    def along_gravity_m_s2(self) -> float:
        """Bias of the accelerometer along gravity, positive where it measures too much."""
        return math.hypot(*self.force) - GRAVITY

    def __str__(self) -> str:
        x, y, z = self.rate
        return (
            f"gyroscope bias ({x:+.4f}, {y:+.4f}, {z:+.4f}) rad/s, "
            f"accelerometer {self.along_gravity_m_s2:+.3f} m/s^2 along gravity, {self.seconds:.1f} s at rest"
        )


class BenchCalibration:
    """Collects blocks of a resting vehicle. `refusal` is why it must not be armed yet; "" if it may be."""

    def __init__(self, config: EstimatorConfig) -> None:
        self._limits = (config.calibration_force_max_m_s2,) * 3 + (config.calibration_rate_max_rad_s,) * 3
        self._bias_max = config.calibration_bias_max_rad_s
        self._blocks_wanted = math.ceil(config.calibration_s / BLOCK_S)
        self.refusal = CALIBRATING if self._blocks_wanted else ""
        self.accepted: Calibration | None = None
        """The newest one, also while the vehicle is calibrated again."""
        self.count = 0
        """Calibrations accepted so far."""
        self.movements = 0
        """How often a movement made a calibration begin again."""
        self._began_ns: int | None = None
        self._sums: tuple[float, ...] = (0.0,) * 6
        self._samples = 0
        self._begin()

    def summary(self) -> dict[str, Any]:
        """For the flight record. Without an accepted calibration only the counts."""
        counts = {"accepted": self.count, "movements": self.movements}
        if self.accepted is None:
            return counts
        return {
            **counts,
            "gyro_bias_rad_s": list(self.accepted.rate),
            "accelerometer_along_gravity_m_s2": self.accepted.along_gravity_m_s2,
            "seconds": self.accepted.seconds,
        }

    def interrupt(self) -> None:
        """Forget what has been collected: the vehicle is not at rest. A kept calibration stays."""
        self._begin_block(None)
        self._begin()

    def add(self, reading: ImuReading) -> str:
        """Add a sample of a vehicle that rests with its motors off; returns the text of an event, or ""."""
        if not self._blocks_wanted:
            return ""
        began_ns = self._began_ns
        if began_ns is None:
            began_ns = self._began_ns = reading.time_ns
        sums = self._sums
        ax, ay, az = reading.accelerometer
        gx, gy, gz = reading.gyroscope
        self._sums = (sums[0] + ax, sums[1] + ay, sums[2] + az, sums[3] + gx, sums[4] + gy, sums[5] + gz)
        self._samples += 1
        if reading.time_ns - began_ns < BLOCK_S * 1e9:
            return ""
        samples, seconds = self._samples, (reading.time_ns - began_ns) * 1e-9
        block = tuple(total / samples for total in self._sums)
        self._begin_block(reading.time_ns)
        if samples < LEAST_SAMPLES:
            self._begin()
            return ""
        return self._judge(block, samples, seconds)

    def _begin_block(self, began_ns: int | None) -> None:
        """Start a block at the time of a sample, or at the next one."""
        self._began_ns = began_ns
        self._sums = (0.0,) * 6
        self._samples = 0

    def _begin(self) -> None:
        """Start the collection of blocks again."""
        self._blocks: list[tuple[float, ...]] = []
        self._collected, self._collected_s = 0, 0.0

    def _judge(self, block: tuple[float, ...], samples: int, seconds: float) -> str:
        """Compare a block with the calibration that is kept, or with the blocks before."""
        limits = self._limits
        if not self.refusal and self.accepted is not None:
            kept = self.accepted.rate
            off = _first_beyond(block[3:], kept, limits[3:])
            return "" if off is None else self._restart(3 + off, block[3 + off] - kept[off])
        if self._blocks:
            mean = self._mean()
            off = _first_beyond(block, mean, limits)
            if off is not None:
                return self._restart(off, block[off] - mean[off])
        self._blocks.append(block)
        self._collected += samples
        self._collected_s += seconds
        return self._conclude() if len(self._blocks) == self._blocks_wanted else ""

    def _restart(self, index: int, change: float) -> str:
        """Begin again with the next block. Only the first of several movements in a row is an event."""
        self._begin()
        if self.refusal == MOVED:
            return ""
        self.refusal = MOVED
        self.movements += 1
        sensor, unit = ("accelerometer", "m/s^2") if index < 3 else ("gyroscope", "rad/s")
        return f"{MOVED}: {sensor} {AXES[index % 3]} off by {change:+.2g} {unit}"

    def _mean(self) -> tuple[float, ...]:
        return tuple(sum(values) / len(self._blocks) for values in zip(*self._blocks, strict=True))

    def _conclude(self) -> str:
        """Accept the calibration, unless the gyroscope's bias is too large."""
        mean, samples, seconds = self._mean(), self._collected, self._collected_s
        self._begin()
        off = _first_beyond(mean[3:], (0.0,) * 3, (self._bias_max,) * 3)
        if off is not None:
            before, bias = self.refusal, mean[3 + off]
            self.refusal = f"gyroscope {AXES[off]} has a bias of {bias:+.2f} rad/s, the limit is {self._bias_max:g}"
            return "" if self.refusal == before else self.refusal
        self.accepted = Calibration((mean[0], mean[1], mean[2]), (mean[3], mean[4], mean[5]), samples, seconds)
        self.refusal = ""
        self.count += 1
        return f"IMU calibrated: {self.accepted}"


def _first_beyond(values: tuple[float, ...], means: tuple[float, ...], limits: tuple[float, ...]) -> int | None:
    """Index of the first value that is off its mean by more than its limit; None if there is none."""
    for index, (value, mean, limit) in enumerate(zip(values, means, limits, strict=True)):
        if not abs(value - mean) <= limit:
            return index
    return None
