"""Whether the vehicle's inertial stream is good enough to fly on: rate, lateness, gaps, time base, and 1 g at rest.

Theory of operation. Samples are gathered in blocks; a verdict is drawn at the end of each block over the newest few
(about one second), so that a fault is remembered for that long and then forgiven. The verdict gates arming, never
flight: in the air the supervisor's age limits rule.
"""

import math
from collections import deque
from typing import Final, NamedTuple

from pydantic import Field

from configs.loader import Record

BLOCK_SAMPLES: Final = 50
BLOCKS: Final = 4
STANDARD_GRAVITY: Final = 9.80665
NOT_JUDGED: Final = "the vehicle's IMU has not been judged yet"


class LinkHealthConfig(Record):
    """What the stream must be like before the vehicle may be armed."""

    imu_rate_min_hz: float = Field(default=180.0, gt=0, description="Hz, samples that arrive")
    imu_rate_max_hz: float = Field(default=220.0, gt=0, description="Hz")
    late_s: float = Field(default=0.010, gt=0, description="s behind the quickest sample; such a sample is late")
    late_share_max: float = Field(default=0.05, ge=0, le=1, description="share of late samples")
    gap_max_s: float = Field(default=0.040, gt=0, description="s between two arrivals; less than imu_silent_s")
    backwards_share_max: float = Field(default=0.05, ge=0, le=1, description="share of samples with old time stamps")
    clock_rate_tolerance: float = Field(default=0.05, gt=0, description="1; the vehicle's second against ours")
    gravity_tolerance_m_s2: float = Field(default=1.5, gt=0, description="m/s^2; |accelerometer| at rest against 1 g")


class _Block(NamedTuple):
    """What is kept of some samples in a row."""

    samples: int
    first_stamp_ns: int
    first_arrival_ns: int
    late: int
    gap_ns: int
    """Longest time between two arrivals, the one before the block included."""
    backwards: int
    """Samples that were dropped meanwhile because their time was not new."""
    force_squared: float
    """Sum of the squared specific force, (m/s^2)^2."""


class LinkHealth:
    """Judges the samples it is shown. `fault` is why they are not good enough; "" when they are."""

    def __init__(self, config: LinkHealthConfig) -> None:
        self._config = config
        self._late_ns = int(config.late_s * 1e9)
        self.reset()

    def reset(self) -> None:
        """Forgets everything: another vehicle, or another clock."""
        self._blocks: deque[_Block] = deque(maxlen=BLOCKS)
        self._arrival_ns: int | None = None
        self._count = self._late = self._gap_ns = self._backwards = 0
        self._first_stamp_ns = self._first_arrival_ns = 0
        self._force_squared = 0.0
        self.fault = NOT_JUDGED

    def take(self, stamp_ns: int, delay_ns: int, arrival_ns: int, force: tuple[float, float, float]) -> None:
        """One good sample: the vehicle's stamp, how far it came behind the quickest, when it came, specific force."""
        if self._arrival_ns is not None:
            gap_ns = arrival_ns - self._arrival_ns
            if gap_ns > self._gap_ns:
                self._gap_ns = gap_ns
        self._arrival_ns = arrival_ns
        if self._count == 0:
            self._first_stamp_ns, self._first_arrival_ns = stamp_ns, arrival_ns
        self._count += 1
        self._late += delay_ns > self._late_ns
        x, y, z = force
        self._force_squared += x * x + y * y + z * z
        if self._count == BLOCK_SAMPLES:
            self._end_block(stamp_ns, arrival_ns)

    def note_backwards(self) -> None:
        """One sample that was dropped because its time stamp was not newer than the last."""
        self._backwards += 1

    def _end_block(self, stamp_ns: int, arrival_ns: int) -> None:
        self._blocks.append(
            _Block(
                self._count,
                self._first_stamp_ns,
                self._first_arrival_ns,
                self._late,
                self._gap_ns,
                self._backwards,
                self._force_squared,
            )
        )
        self._count = self._late = self._gap_ns = self._backwards = 0
        self._force_squared = 0.0
        self.fault = self._judge(stamp_ns, arrival_ns)

    def _judge(self, stamp_ns: int, arrival_ns: int) -> str:
        """The first thing that is wrong; the time base before all that depends on it."""
        config, blocks = self._config, self._blocks
        samples = sum(block.samples for block in blocks)
        arrival_s = (arrival_ns - blocks[0].first_arrival_ns) * 1e-9
        stamp_s = (stamp_ns - blocks[0].first_stamp_ns) * 1e-9
        clock_rate = stamp_s / arrival_s if arrival_s > 0.0 else math.inf
        if abs(clock_rate - 1.0) > config.clock_rate_tolerance:
            return f"time base: the vehicle's clock runs at {clock_rate:.3g} of ours"
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
            return f"IMU jitter: {late_share:.0%} come more than {config.late_s * 1e3:.0f} ms late"
        force = math.sqrt(sum(block.force_squared for block in blocks) / samples)
        if abs(force - STANDARD_GRAVITY) > config.gravity_tolerance_m_s2:
            return f"accelerometer gives {force:.3g} m/s^2 at rest"
        return ""
