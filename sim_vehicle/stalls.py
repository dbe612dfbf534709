"""Stalls of the simulator's process, and whether they make the flight invalid.

While the process stands still, onboard gets no sensors. No vehicle does that, so the flight says nothing about one.
"""

from typing import Final

STALL_NS: Final = 20_000_000
"""A step that is late by this much is a stall."""
STALL_MAX_NS: Final = 100_000_000
"""A longer stall makes every flight invalid."""
AFTER_STALL_NS: Final = 2_000_000_000
"""A stall makes a crash within this time invalid."""


class Stalls:
    """Collects late steps; `invalid_reason` says why the flight is invalid, "" if it is valid."""

    def __init__(self) -> None:
        self._last: tuple[int, int] | None = None  # flight time, duration
        self.invalid_reason = ""

    def note(self, now_ns: int, late_ns: int) -> None:
        """Note that a step ran `late_ns` late, at flight time `now_ns`."""
        if late_ns < STALL_NS:
            return
        self._last = now_ns, late_ns
        if late_ns > STALL_MAX_NS and not self.invalid_reason:
            self.invalid_reason = f"the simulator stood still for {_ms(late_ns)} at {now_ns * 1e-9:.2f} s"

    def note_crash(self, now_ns: int) -> None:
        """Note that the vehicle crashed at flight time `now_ns`."""
        if self._last is None or self.invalid_reason or now_ns - self._last[0] > AFTER_STALL_NS:
            return
        stalled_at_ns, late_ns = self._last
        after = f"{max(0, now_ns - stalled_at_ns) * 1e-9:.2f} s after the simulator stood still for {_ms(late_ns)}"
        self.invalid_reason = f"the vehicle crashed {after}"


def _ms(duration_ns: int) -> str:
    return f"{duration_ns * 1e-6:.0f} ms"
