"""Receives from one peer what a step can afford, also while somebody floods its port from the peer's own address.

Theory of operation. A socket's queue is first in, first out: a process that takes 16 datagrams a tick from a flood of
5,000 a second finds the newest reading behind all that came before it, and the kernel drops what comes while the queue
is full. So every step reads the queue to its end. A few datagrams go to the core as they are: it counts what is wrong
with each. Of more, the newest are screened, newest first: what is no message of the peer is dropped, a repetition is
dropped, and of each kind of message only the newest few are used. All that is dropped here is counted by reason.
"""

from collections import Counter
from collections.abc import Callable
from typing import Any, Final, Protocol

from runtime.sockets import Stamped

READ_MAX: Final = 4096
"""Most datagrams read in one step: more than the queue of the kernel holds."""
SCREENED_MAX: Final = 400
"""Most datagrams screened in one step, about 3 us each."""
REFUSED: Final = -1
"""A screen's answer for a datagram that is no message of the peer; otherwise its kind, 0 or more."""
REPORT_PERIOD_NS: Final = 1_000_000_000

Screen = Callable[[bytes], int]


class StampedSource(Protocol):
    """A socket or a serial line."""

    def receive_stamped(self, limit: int) -> list[Stamped]:
        """The datagrams that have arrived, oldest first, at most `limit`."""


class Intake:
    """Bounded reception from one peer.

    Parameters
    ----------
    name: the port, for reports.
    few: up to so many datagrams are passed on unscreened.
    kind_max: of more, at most so many of each kind are passed on.
    screen: sorts a datagram into a kind, or REFUSED; it must not raise, and changes nothing.
    secret: whether a datagram holds a secret; such a one goes nowhere.
    """

    def __init__(
        self,
        name: str,
        source: StampedSource,
        few: int,
        kind_max: int,
        screen: Screen,
        secret: Callable[[bytes], bool] | None = None,
    ) -> None:
        self.name = name
        self._source = source
        self._few = few
        self._kind_max = kind_max
        self._screen = screen
        self._secret = secret
        self._reported_ns = 0
        self._reported = 0
        self._flooded = False
        self._secrets_reported = 0
        self.secrets = 0
        """Datagrams dropped because they hold a secret."""
        self.dropped: Counter[str] = Counter()
        """By reason: refused (no message of the peer), repeated, surplus (of one kind), unread (not screened)."""

    def receive(self, periods: int = 1) -> list[Stamped]:
        """What is to be used of the datagrams that have arrived in `periods` steps, oldest first."""
        came = self._source.receive_stamped(READ_MAX)
        if self._secret is not None and came:
            came = self._without_secrets(came)
        if len(came) <= self._few * periods:
            return came
        chosen: list[Stamped] = []
        seen: set[bytes] = set()
        counts: dict[int, int] = {}
        refused = repeated = surplus = 0
        screen, kind_max = self._screen, self._kind_max * periods
        for one in came[: -SCREENED_MAX - 1 : -1]:
            datagram = one.datagram
            if datagram in seen:
                repeated += 1
                continue
            seen.add(datagram)
            kind = screen(datagram)
            if kind < 0:
                refused += 1
                continue
            count = counts[kind] = counts.get(kind, 0) + 1
            if count > kind_max:
                surplus += 1
            else:
                chosen.append(one)
        unread = max(0, len(came) - SCREENED_MAX)
        self.dropped.update(refused=refused, repeated=repeated, surplus=surplus, unread=unread)
        chosen.reverse()
        return chosen

    def _without_secrets(self, came: list[Stamped]) -> list[Stamped]:
        assert self._secret is not None
        kept = [one for one in came if not self._secret(one.datagram)]
        self.secrets += len(came) - len(kept)
        return kept

    def report(self, now_ns: int) -> str:
        """At most once a second: that the port is being flooded, or no longer; else ""."""
        since_ns = now_ns - self._reported_ns
        if since_ns < REPORT_PERIOD_NS:
            return ""
        if self.secrets > self._secrets_reported:
            self._secrets_reported = self.secrets
            return f"{self.name} port: a datagram with a key (SETUP_SIGNING) was dropped; keys come from files only"
        total = self.dropped.total() + self.overflowed
        more, self._reported, self._reported_ns = total - self._reported, total, now_ns
        flooded, before = more > 0, self._flooded
        self._flooded = flooded
        if flooded:
            return f"{self.name} port flooded: {more * 1e9 / since_ns:.0f} datagrams/s dropped"
        return f"{self.name} port: the flood is over" if before else ""

    @property
    def overflowed(self) -> int:
        """Datagrams that the kernel dropped because its queue was full."""
        return int(getattr(self._source, "dropped", 0))

    def summary(self) -> dict[str, Any]:
        """What was dropped, by reason, for the flight record."""
        counts = {**self.dropped, "secret": self.secrets}
        return {**{reason: count for reason, count in counts.items() if count}, "overflowed": self.overflowed}
