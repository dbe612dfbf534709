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
STOPPED_NS: Final = 10_000_000
"""Motors that stop within this time of a stall were stopped in it: onboard got no IMU."""


class Stalls:
    """Collects late steps; `invalid_reason` says why the flight is invalid, "" if it is valid."""

    def __init__(self) -> None:
        self._last: tuple[int, int] | None = None  # flight time, duration
        self._longest: tuple[int, int] | None = None
        self.invalid_reason = ""

    def note(self, now_ns: int, late_ns: int) -> None:
        """Note that a step ran `late_ns` late, at flight time `now_ns`."""
        if late_ns < STALL_NS:
            return
        self._last = now_ns, late_ns
        if self._longest is None or late_ns > self._longest[1]:
            self._longest = self._last
        if late_ns > STALL_MAX_NS and not self.invalid_reason:
            self.invalid_reason = _described(self._last)

    def note_crash(self, now_ns: int) -> None:
        """Note that the vehicle crashed at flight time `now_ns`."""
        stall = self._stall_within(AFTER_STALL_NS, now_ns)
        if stall is not None:
            after = f"{max(0, now_ns - stall[0]) * 1e-9:.2f} s after the simulator stood still for {_ms(stall[1])}"
            self.invalid_reason = f"the vehicle crashed {after}"

    def note_stop(self, now_ns: int) -> None:
        """Note that onboard stopped the motors, not at a landing, at flight time `now_ns`."""
        stall = self._stall_within(STOPPED_NS, now_ns)
        if stall is not None:
            self.invalid_reason = f"the motors were stopped when {_described(stall)}"

    def note_no_flight(self) -> None:
        """Note that the vehicle was never armed."""
        if self._longest is not None and not self.invalid_reason:
            self.invalid_reason = f"the vehicle was never armed; {_described(self._longest)}"

    def _stall_within(self, time_ns: int, now_ns: int) -> tuple[int, int] | None:
        """Flight time and duration of the last stall, if it ended within `time_ns` and the flight is valid so far."""
        if self._last is None or self.invalid_reason or now_ns - self._last[0] > time_ns:
            return None
        return self._last


def _described(stall: tuple[int, int]) -> str:
    at_ns, late_ns = stall
    return f"the simulator stood still for {_ms(late_ns)} at {at_ns * 1e-9:.2f} s"


def _ms(duration_ns: int) -> str:
    return f"{duration_ns * 1e-6:.0f} ms"
