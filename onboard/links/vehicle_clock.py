"""Maps the vehicle's clock to onboard's, and detects a vehicle that restarted."""

from typing import Final

from protocol.conventions import NEVER_NS

RESTART_SAMPLES: Final = 3
"""This many samples in a row on an earlier time mean that the vehicle restarted."""


class VehicleClock:
    """The offset of the clocks is the least (arrival - stamp) seen, and grows by the allowed drift.

    The least delay is the one without queueing, so the mapped time is at most that delay after the true time.
    """

    def __init__(self, drift_ppm: float, restart_ns: int) -> None:
        """`restart_ns`: a step back of more may be a restart; a smaller one is a late datagram."""
        self._drift = drift_ppm * 1e-6
        self._restart_ns = restart_ns
        self._offset_ns = 0
        self._suspects = 0
        self._suspect_ns = NEVER_NS
        self.newest_ns = NEVER_NS
        """The newest accepted stamp, vehicle's clock."""
        self.restarts = 0
        """How often the vehicle's clock restarted."""
        self.interleaved = 0
        """How often stamps of an earlier time came between good ones."""
        self.known = False
        """Whether there is a mapping."""

    def accept(self, stamp_ns: int, now_ns: int) -> str:
        """Check an IMU time stamp. Returns "" (good), "restart" (good, on a new clock) or why it is refused."""
        step_ns = stamp_ns - self.newest_ns
        if step_ns > 0:
            latency_ns = now_ns - stamp_ns
            if not self.known or latency_ns < self._offset_ns:
                self._offset_ns = latency_ns
                self.known = True
            else:
                drift_ns = int(self._drift * step_ns) + 1
                self._offset_ns = min(latency_ns, self._offset_ns + drift_ns)
            self.newest_ns = stamp_ns
            if self._suspects:
                self._suspects = 0
                self.interleaved += 1
            return ""
        if step_ns == 0:
            return "time_repeated"
        if -step_ns < self._restart_ns:
            return "time_backwards"
        self._suspects = self._suspects + 1 if stamp_ns > self._suspect_ns else 1
        self._suspect_ns = stamp_ns
        if self._suspects < RESTART_SAMPLES:
            return "time_backwards"
        self.reset()
        self.restarts += 1
        self.accept(stamp_ns, now_ns)
        return "restart"

    def to_onboard(self, stamp_ns: int) -> int:
        """Onboard time of a vehicle time stamp."""
        return stamp_ns + self._offset_ns

    def reset(self) -> None:
        """Forget the mapping; the next stamp starts a new one."""
        self.newest_ns = self._suspect_ns = NEVER_NS
        self._suspects = 0
        self.known = False
