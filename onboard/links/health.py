"""Checks before arming whether the vehicle's inertial stream is good enough: rate, delay, gaps, time base, sensors.

Samples are collected in blocks. At the end of each block the newest blocks (about one second) are judged, so a fault
counts for one second after its end. The result gates arming only; in flight the supervisor's age limits apply. A
vehicle that may be armed stands still: the mean specific force is 1 g, upwards on the body's z axis, the mean rate is
the gyroscope's bias, and an axis that never changes is stuck.
"""

import math
from collections import deque
from typing import Final, NamedTuple

import numpy as np
from pydantic import Field

from configs.loader import ConfigRecord
from protocol.conventions import GRAVITY, Array

BLOCK_SAMPLES: Final = 50
BLOCKS: Final = 4
AXES: Final = tuple(f"{sensor} {axis}" for sensor in ("accelerometer", "gyroscope") for axis in "xyz")
NOT_JUDGED: Final = "IMU not checked yet"


class LinkHealthConfig(ConfigRecord):
    """Limits of the stream before arming."""

    imu_rate_min_hz: float = Field(default=180.0, gt=0, description="Hz, samples that arrive")
    imu_rate_max_hz: float = Field(default=220.0, gt=0, description="Hz")
    late_s: float = Field(default=0.010, gt=0, description="s behind the fastest sample; more is late")
    late_share_max: float = Field(default=0.05, ge=0, le=1, description="share of late samples")
    gap_max_s: float = Field(default=0.040, gt=0, description="s between two arrivals; less than imu_silent_s")
    backwards_share_max: float = Field(default=0.05, ge=0, le=1, description="share of samples with old time stamps")
    clock_rate_tolerance: float = Field(default=0.05, gt=0, description="1; vehicle's clock rate against onboard's")
    gravity_tolerance_m_s2: float = Field(default=1.5, gt=0, description="m/s^2; |accelerometer| at rest against 1 g")
    rest_rate_max_rad_s: float = Field(default=0.3, gt=0, description="rad/s; mean rate at rest (gyroscope bias)")
    flow_silent_s: float = Field(default=0.0, ge=0, description="s without optical flow; 0: it is not needed")


class _Block(NamedTuple):
    """Summary of some samples in a row."""

    samples: int
    first_stamp_ns: int
    first_arrival_ns: int
    late: int
    gap_ns: int
    """Longest time between two arrivals, from the one before the block on."""
    backwards: int
    """Samples dropped in this time because their time stamp was not new."""
    mean: Array
    """[6]: specific force, m/s^2, and rates, rad/s."""
    inertial: Array
    """[samples, 6]: the samples."""


class LinkHealth:
    """Judges the inertial stream when `fault` is read; it is not read in flight."""

    def __init__(self, config: LinkHealthConfig) -> None:
        self._config = config
        self._late_ns = int(config.late_s * 1e9)
        self.reset()

    def reset(self) -> None:
        """Forget everything: another vehicle, or another clock."""
        self._blocks: deque[_Block] = deque(maxlen=BLOCKS)
        self._arrival_ns: int | None = None
        self._late = self._gap_ns = self._backwards = 0
        self._first_stamp_ns = self._first_arrival_ns = 0
        self._inertial: list[tuple[float, ...]] = []
        self.force: Array = np.zeros(3)
        """[3] m/s^2: mean specific force of the newest samples; zero before there is one."""
        self._ended_ns = 0, 0
        self._fault: str | None = NOT_JUDGED

    @property
    def fault(self) -> str:
        """Why the stream is not good enough; "" if it is."""
        if self._fault is None:
            self._fault = self._judge(*self._ended_ns)
        return self._fault

    def add(self, stamp_ns: int, delay_ns: int, arrival_ns: int, inertial: tuple[float, ...]) -> None:
        """Add a good sample.

        Parameters
        ----------
        stamp_ns: the vehicle's clock.
        delay_ns: delay beyond that of the fastest sample.
        arrival_ns: the onboard clock.
        inertial: [6] specific force, m/s^2, and rates, rad/s.
        """
        if self._arrival_ns is not None:
            gap_ns = arrival_ns - self._arrival_ns
            if gap_ns > self._gap_ns:
                self._gap_ns = gap_ns
        self._arrival_ns = arrival_ns
        if not self._inertial:
            self._first_stamp_ns, self._first_arrival_ns = stamp_ns, arrival_ns
        self._late += delay_ns > self._late_ns
        self._inertial.append(inertial)
        if len(self._inertial) == BLOCK_SAMPLES:
            self._end_block(stamp_ns, arrival_ns)

    def count_backwards(self) -> None:
        """Count a sample that was dropped because its time stamp was not new."""
        self._backwards += 1

    def _end_block(self, stamp_ns: int, arrival_ns: int) -> None:
        inertial = np.array(self._inertial)
        self._blocks.append(
            _Block(
                len(inertial),
                self._first_stamp_ns,
                self._first_arrival_ns,
                self._late,
                self._gap_ns,
                self._backwards,
                inertial.mean(axis=0),
                inertial,
            )
        )
        self._late = self._gap_ns = self._backwards = 0
        self._inertial = []
        self.force = np.mean([block.mean[:3] for block in self._blocks], axis=0)
        self._ended_ns, self._fault = (stamp_ns, arrival_ns), None  # to be judged

    def _judge(self, stamp_ns: int, arrival_ns: int) -> str:
        """The first fault; the time base first, because the other checks depend on it."""
        config, blocks = self._config, self._blocks
        samples = sum(block.samples for block in blocks)
        arrival_s = (arrival_ns - blocks[0].first_arrival_ns) * 1e-9
        stamp_s = (stamp_ns - blocks[0].first_stamp_ns) * 1e-9
        clock_rate = stamp_s / arrival_s if arrival_s > 0.0 else math.inf
        if abs(clock_rate - 1.0) > config.clock_rate_tolerance:
            return f"time base: vehicle clock runs at {clock_rate:.3g} times the onboard clock"
        backwards = sum(block.backwards for block in blocks) / samples
        if backwards > config.backwards_share_max:
            return f"time base: {backwards:.0%} of the samples have old time stamps; two vehicles?"
        rate_hz = (samples - 1) / arrival_s
        if not config.imu_rate_min_hz <= rate_hz <= config.imu_rate_max_hz:
            return f"IMU at {rate_hz:.0f} Hz"
        gap_s = max(block.gap_ns for block in blocks) * 1e-9
        if gap_s > config.gap_max_s:
            return f"IMU gap of {gap_s * 1e3:.0f} ms"
        late_share = sum(block.late for block in blocks) / samples
        if late_share > config.late_share_max:
            return f"IMU jitter: {late_share:.0%} of the samples are more than {config.late_s * 1e3:.0f} ms late"
        return self._judge_rest()

    def _judge_rest(self) -> str:
        """The first fault of the sensors of a vehicle that stands still."""
        config, blocks = self._config, self._blocks
        unchanged = [(block.inertial == block.inertial[0]).all(axis=0) for block in blocks]
        stuck = np.flatnonzero(np.all(unchanged, axis=0))
        if len(stuck):
            return f"{AXES[stuck[0]]} never changes: stuck"
        force = float(np.linalg.norm(self.force))
        if abs(force - GRAVITY) > config.gravity_tolerance_m_s2:
            return f"accelerometer gives {force:.3g} m/s^2 at rest"
        axis = int(np.argmax(np.abs(self.force)))
        if axis != 2:
            return f"gravity is on {AXES[axis]}: axes swapped, or the vehicle lies on its side"
        if self.force[2] > 0.0:
            return f"accelerometer z gives {self.force[2]:+.1f} m/s^2 at rest, not -9.8: wrong sign, or upside down"
        rates = np.mean([block.mean[3:] for block in blocks], axis=0)
        axis = int(np.argmax(np.abs(rates)))
        if abs(rates[axis]) > config.rest_rate_max_rad_s:
            return f"{AXES[3 + axis]} gives {rates[axis]:+.2g} rad/s: the vehicle moves, or wrong bias or unit"
        return ""
