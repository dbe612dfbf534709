"""The peer's clock against ours, from time sync exchanges (the four time stamps of NTP, filtered by round trip).

And our own clock made safe to reckon with: deadlines and ages go wrong for good when it is set back.
"""

from collections import deque
from typing import Final

OPEN_REQUESTS_MAX: Final = 16
SAMPLES_MAX: Final = 16
REQUEST_LIFE_NS: Final = 2_000_000_000
JUMP_SLACK_NS: Final = 5_000_000


class ForwardClock:
    """A clock that never goes back: where the one it is read from does, it stands still once and then runs on."""

    __slots__ = ("_latest_ns", "_shift_ns", "jumps")

    def __init__(self) -> None:
        self._latest_ns: int | None = None
        self._shift_ns = 0
        self.jumps = 0
        """How often the clock below went back."""

    def at(self, now_ns: int) -> int:
        """The time to reckon with when the clock below says `now_ns`."""
        now_ns += self._shift_ns
        latest_ns = self._latest_ns
        if latest_ns is not None and now_ns < latest_ns:
            self._shift_ns += latest_ns - now_ns
            self.jumps += 1
            return latest_ns
        self._latest_ns = now_ns
        return now_ns


class ClockEstimate:
    """Offset = peer clock minus ours.

    An exchange with round trip r errs by at most r / 2, so of the last SAMPLES_MAX the one with the shortest round
    trip is believed. An offset that contradicts the believed one by more than both errors and a slack for drift
    means that a clock jumped: everything older is forgotten.
    """

    def __init__(self) -> None:
        self._open: deque[int] = deque(maxlen=OPEN_REQUESTS_MAX)
        self._samples: deque[tuple[int, int]] = deque(maxlen=SAMPLES_MAX)  # (round trip, offset)
        self.offset_ns: int | None = None
        self.round_trip_ns: int | None = None
        self.jumps = 0

    def restart(self) -> None:
        """Starts anew, as after a restart of the peer; open requests stay open."""
        self._samples.clear()
        self.offset_ns = self.round_trip_ns = None

    def note_request(self, origin_ns: int) -> None:
        """Notes a request that leaves now."""
        self._open.append(origin_ns)

    def is_open(self, origin_ns: int, now_ns: int) -> bool:
        """Whether a reply with this origin answers a request of ours, recently made and not yet answered."""
        return origin_ns in self._open and 0 <= now_ns - origin_ns <= REQUEST_LIFE_NS

    def receive_reply(self, origin_ns: int, receive_ns: int, transmit_ns: int, now_ns: int) -> bool:
        """Takes in a reply; False when its request is not open or its round trip would be negative."""
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
