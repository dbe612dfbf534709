"""Sessions and their replay windows: which datagrams of a genuine peer are new.

A session is one run of a process. Its number comes from the wall clock (`session_number`), so a restarted peer has a
larger one. Rules for a datagram whose MAC is right:

1. A session number above all accepted before is a restarted peer. It is accepted, and the current session is retired.
2. Any other session is refused, so that a recording cannot be replayed.
3. Exception, for a peer whose wall clock was set back: an unknown older session is accepted if its datagram answers an
   open time sync request of this side, and the current session has been silent for `SILENCE_BEFORE_OLDER_NS`. No
   recording contains that answer. Onboard sends requests regularly; offboard sends one when a datagram of such a
   session was refused (`Endpoint.challenge`).
4. Within a session each sequence number is accepted once; numbers `WINDOW` or more below the newest are too old.
"""

from collections import deque
from typing import Final

WINDOW: Final = 256
RETIRED_MAX: Final = 256
SEQUENCE_JUMP_MAX: Final = 2**32
SILENCE_BEFORE_OLDER_NS: Final = 1_000_000_000


def session_number(wall_clock_ns: int, entropy: int) -> int:
    """A session number: 44 bits of wall-clock milliseconds, then 20 random bits for starts in the same millisecond."""
    return ((wall_clock_ns // 1_000_000) & (2**44 - 1)) << 20 | (entropy & (2**20 - 1))


def session_start_ns(session: int) -> int:
    """Wall clock, ns, at the start of a session, to the millisecond."""
    return (session >> 20) * 1_000_000


class ReplayWindow:
    """The sequence numbers received in one session: the newest, a bitmap of the WINDOW before it, and counts."""

    __slots__ = ("_seen", "first", "newest", "received")

    def __init__(self, first: int) -> None:
        self.first = first
        self.newest = first
        self.received = 0
        self._seen = 0  # bit i stands for newest - i

    def verdict(self, sequence: int) -> str:
        """Empty if the number is new, else the reason against it: "duplicate", "too_old" or "sequence" (huge jump)."""
        back = self.newest - sequence
        if back < 0:
            return "" if -back <= SEQUENCE_JUMP_MAX else "sequence"
        if back >= WINDOW:
            return "too_old"
        return "duplicate" if self._seen >> back & 1 else ""

    def accept(self, sequence: int) -> bool:
        """Store a number as received; returns whether it came out of order. Call only if `verdict` is ""."""
        self.received += 1
        ahead = sequence - self.newest
        if ahead > 0:
            self._seen = (self._seen << ahead | 1) & (2**WINDOW - 1) if ahead < WINDOW else 1
            self.newest = sequence
            return False
        self._seen |= 1 << -ahead
        self.first = min(self.first, sequence)
        return ahead < 0

    @property
    def lost(self) -> int:
        """Count of numbers between the first and the newest that have not arrived."""
        return self.newest - self.first + 1 - self.received


class PeerSessions:
    """The current session of the peer, and the retired ones."""

    __slots__ = ("_lost_before", "_newest", "_retired", "current", "window")

    def __init__(self) -> None:
        self.current: int | None = None
        self.window = ReplayWindow(0)
        self._newest = -1
        self._retired: deque[int] = deque(maxlen=RETIRED_MAX)
        self._lost_before = 0

    def is_newer(self, session: int) -> bool:
        """Whether the session number is above all accepted before (rule 1)."""
        return session > self._newest

    def may_return(self, session: int) -> bool:
        """Whether rule 3 may accept the session: it is not retired, and the list of retired ones is still complete."""
        return session not in self._retired and len(self._retired) < RETIRED_MAX

    def start(self, session: int, sequence: int) -> None:
        """Retire the current session and start another, whose first received number is `sequence`."""
        if self.current is not None:
            self._retired.append(self.current)
            self._lost_before += self.window.lost
        self.current = session
        self._newest = max(self._newest, session)
        self.window = ReplayWindow(sequence)

    @property
    def lost(self) -> int:
        """Lost datagrams, in all sessions."""
        return self._lost_before + (0 if self.current is None else self.window.lost)
