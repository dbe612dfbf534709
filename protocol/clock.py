"""Clocks: a clock that never goes back, and the offset of the peer's clock from time sync exchanges.

The offset is computed from the four time stamps of NTP, and filtered by round trip time.
"""

from collections import deque
from typing import Final

OPEN_REQUESTS_MAX: Final = 16
SAMPLES_MAX: Final = 16
REQUEST_LIFE_NS: Final = 2_000_000_000
JUMP_SLACK_NS: Final = 5_000_000


class ForwardClock:
    """A clock that never goes back. When its source does, it repeats its last time once and continues from there."""

    __slots__ = ("_latest_ns", "_shift_ns", "jumps")

    def __init__(self) -> None:
        self._latest_ns: int | None = None
        self._shift_ns = 0
        self.jumps = 0
        """How often the source went back."""

    def at(self, now_ns: int) -> int:
        """The time, ns, when the source shows `now_ns`."""
        now_ns += self._shift_ns
        latest_ns = self._latest_ns
        if latest_ns is not None and now_ns < latest_ns:
            self._shift_ns += latest_ns - now_ns
            self.jumps += 1
            return latest_ns
        self._latest_ns = now_ns
        return now_ns


class ClockEstimate:
    """Estimate of the offset, peer clock minus own clock, ns.

    The error of an exchange with round trip r is at most r / 2, so the estimate is that of the exchange with the
    shortest round trip among the last SAMPLES_MAX. An offset that differs from the estimate by more than both errors
    and JUMP_SLACK_NS (for drift) means that a clock jumped: all older exchanges are discarded.
    """

    def __init__(self) -> None:
        self._open: deque[int] = deque(maxlen=OPEN_REQUESTS_MAX)
        self._samples: deque[tuple[int, int]] = deque(maxlen=SAMPLES_MAX)  # (round trip, offset)
        self.offset_ns: int | None = None
        self.round_trip_ns: int | None = None
        self.jumps = 0

    def restart(self) -> None:
        """Discard all exchanges, as after a restart of the peer; open requests stay open."""
        self._samples.clear()
        self.offset_ns = self.round_trip_ns = None

    def note_request(self, origin_ns: int) -> None:
        """Store a request that is sent now."""
        self._open.append(origin_ns)

    def is_open(self, origin_ns: int, now_ns: int) -> bool:
        """Whether a reply with this origin answers an own request that is recent and not answered yet."""
        return origin_ns in self._open and 0 <= now_ns - origin_ns <= REQUEST_LIFE_NS

    def receive_reply(self, origin_ns: int, receive_ns: int, transmit_ns: int, now_ns: int) -> bool:
        """Receive a reply; returns False if its request is not open or its round trip would be negative."""
        round_trip = (now_ns - origin_ns) - (transmit_ns - receive_ns)
        if not self.is_open(origin_ns, now_ns) or round_trip < 0:
            return False
        self._open.remove(origin_ns)
        offset = ((receive_ns - origin_ns) + (transmit_ns - now_ns)) // 2
        if self.offset_ns is not None and self.round_trip_ns is not None:
            error = (round_trip + self.round_trip_ns) // 2 + JUMP_SLACK_NS
            if abs(offset - self.offset_ns) > error:
                self._samples.clear()
                self.jumps += 1
        self._samples.append((round_trip, offset))
        self.round_trip_ns, self.offset_ns = min(self._samples)
        return True
