"""When a sensor with its own rate samples."""


class Schedule:
    """Sampling times: the first IMU tick at or after each multiple of the sensor's period."""

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz = rate_hz
        self._count = 1
        self.due_ns = round(1e9 / rate_hz)
        """When to sample next."""

    def is_due(self, now_ns: int) -> bool:
        """Whether to sample now; True once per period."""
        if now_ns < self.due_ns:
            return False
        self._count = max(self._count + 1, int(now_ns * 1e-9 * self._rate_hz + 1e-6) + 1)
        self.due_ns = round(self._count * 1e9 / self._rate_hz)
        return True
