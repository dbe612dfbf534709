"""Sessions and their replay windows: which datagrams of a genuine peer are new.

A session is one life of a process. Its number is taken from the wall clock (`session_number`), so a restarted peer
has a larger one. Rules, for a datagram whose MAC is right:

1. A session above every one accepted before is a restarted peer: it is accepted and the current one retires.
2. A session that retired never comes back, and neither does any other old one, so a recording cannot be replayed.
3. Exception, so that a peer whose wall clock was set back is not locked out: an unknown older session comes in with
   the answer to a time sync request of our own that is still open, once the current session has been silent for
   `SILENCE_BEFORE_OLDER_NS`. No recording holds that answer. Onboard asks all the time anyway; offboard asks when
   such a session knocks (`Endpoint.challenge`).
4. Within a session each sequence number counts once; numbers more than `WINDOW` below the newest are too old.
"""

from collections import deque
from typing import Final

WINDOW: Final = 256
RETIRED_MAX: Final = 256
SEQUENCE_JUMP_MAX: Final = 2**32
SILENCE_BEFORE_OLDER_NS: Final = 1_000_000_000


def session_number(wall_clock_ns: int, entropy: int) -> int:
    """A session number of 64 bits: 44 of wall-clock milliseconds, 20 of entropy against two starts within one."""
    return ((wall_clock_ns // 1_000_000) & (2**44 - 1)) << 20 | (entropy & (2**20 - 1))


def session_start_ns(session: int) -> int:
    """The wall clock at the start of a session, to the millisecond."""
    return (session >> 20) * 1_000_000


class ReplayWindow:
    """The sequence numbers seen in one session: the newest, a bitmap of the WINDOW before it, and counts."""

    __slots__ = ("_seen", "first", "newest", "received")

    def __init__(self, first: int) -> None:
        self.first = first
        self.newest = first
        self.received = 0
        self._seen = 0  # bit i stands for newest - i

    def verdict(self, sequence: int) -> str:
        """Empty when the number is new, else why not: "duplicate", "too_old" or "sequence" (an absurd jump)."""
        back = self.newest - sequence
        if back < 0:
            return "" if -back <= SEQUENCE_JUMP_MAX else "sequence"
        if back >= WINDOW:
            return "too_old"
        return "duplicate" if self._seen >> back & 1 else ""

    def accept(self, sequence: int) -> bool:
        """Marks a new number as seen; True when it came out of order. Call only where `verdict` is ""."""
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
        """Numbers between the first and the newest that have not come."""
        return self.newest - self.first + 1 - self.received


class PeerSessions:
    """The peer's current session and those that ended."""

    __slots__ = ("_lost_before", "_newest", "_retired", "current", "window")

    def __init__(self) -> None:
        self.current: int | None = None
        self.window = ReplayWindow(0)
        self._newest = -1
        self._retired: deque[int] = deque(maxlen=RETIRED_MAX)
        self._lost_before = 0

    def is_newer(self, session: int) -> bool:
        """Whether the session is above every one accepted before (rule 1)."""
        return session > self._newest

    def may_return(self, session: int) -> bool:
        """Whether rule 3 may let the session in: it is not known to have ended, nor can it have been forgotten."""
        return session not in self._retired and len(self._retired) < RETIRED_MAX

    def start(self, session: int, sequence: int) -> None:
        """Retires the current session and begins another whose first heard number is `sequence`."""
        if self.current is not None:
            self._retired.append(self.current)
            self._lost_before += self.window.lost
        self.current = session
        self._newest = max(self._newest, session)
        self.window = ReplayWindow(sequence)

    @property
    def lost(self) -> int:
        """Lost datagrams of all sessions."""
        return self._lost_before + (0 if self.current is None else self.window.lost)
