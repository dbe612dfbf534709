"""The radio between onboard and offboard, and all it does to datagrams: one core for real time and lockstep.

A datagram's way: queue of the rate-limited sender (full: dropped), air (blackout, burst loss, independent loss),
corruption, delay with exponential jitter and a rare long tail, duplication. Datagrams keep their order, as a late
one holds back those behind it, unless reordering picks one out to arrive later than its turn. Each direction draws
from a generator of its own, a fixed count of numbers for each datagram, so that the same seed gives datagram i the
same luck whatever else is configured. What became of each datagram is kept and can be flown again
(`RecordedDeliveries`).
"""

import heapq
import math
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from configs.loader import ConfigRecord, merge
from flight_log.schema import RecordType

Direction = Literal["up", "down"]
"""up: onboard to offboard; down: offboard to onboard."""
DIRECTIONS: Final[tuple[Direction, Direction]] = ("up", "down")
RADIO_STREAM: Final = 301
"""Number of the radio's random stream, apart from the vehicle's; real time and lockstep draw the same luck."""
IN_FLIGHT_MAX: Final = 20_000
"""Most datagrams on their way in a direction; beyond it the queue counts as full."""
DELIVERIES_MAX: Final = 1_000_000
"""Most deliveries kept in a direction, over an hour of flight; later ones are counted but not kept."""
_DRAWS: Final = 10
_BLOCK: Final = 128


class BlackoutConfig(ConfigRecord):
    """A window in which nothing gets through."""

    start_s: float = Field(ge=0.0, description="s after the start of the flight")
    end_s: float | None = Field(
        default=None, gt=0.0, description="s after the start of the flight; null: until its end"
    )

    @model_validator(mode="after")
    def _ends_after_it_starts(self) -> "BlackoutConfig":
        if self.end_s is not None and self.end_s <= self.start_s:
            raise ValueError(f"end_s {self.end_s:g} is not after start_s {self.start_s:g}")
        return self


class BurstConfig(ConfigRecord):
    """Gilbert-Elliott loss: two states, changed before each datagram."""

    enter: float = Field(default=0.0, ge=0.0, le=1.0, description="probability good -> bad, per datagram (p)")
    leave: float = Field(
        default=1.0, gt=0.0, le=1.0, description="probability bad -> good, per datagram (r); 1/r is the mean burst"
    )
    loss_in_bad: float = Field(default=1.0, ge=0.0, le=1.0, description="loss probability in the bad state")


class DirectionConfig(ConfigRecord):
    """What one direction does to datagrams."""

    delay_s: float = Field(default=0.0, ge=0.0, le=10.0, description="s, least one-way delay")
    jitter_s: float = Field(default=0.0, ge=0.0, le=10.0, description="s, mean of the exponential delay on top")
    tail_probability: float = Field(
        default=0.0, ge=0.0, le=1.0, description="share of datagrams with a long extra delay"
    )
    tail_min_s: float = Field(default=0.04, ge=0.0, le=10.0, description="s, least extra delay of those")
    tail_max_s: float = Field(default=0.1, ge=0.0, le=10.0, description="s, most extra delay of those")
    rate_bit_s: float | None = Field(default=None, gt=0.0, description="bit/s; null: unlimited")
    queue_bytes: int = Field(
        default=16_384, ge=1200, description="bytes the rate-limited sender holds back before it drops"
    )
    loss: float = Field(default=0.0, ge=0.0, le=1.0, description="independent loss probability")
    burst: BurstConfig = BurstConfig()
    blackouts: tuple[BlackoutConfig, ...] = Field(default=(), description="windows without any delivery")
    duplication: float = Field(default=0.0, ge=0.0, le=1.0, description="probability of a second copy")
    reordering: float = Field(default=0.0, ge=0.0, le=1.0, description="probability of arriving out of turn")
    reordering_delay_s: float = Field(default=0.02, ge=0.0, le=10.0, description="s, most extra delay of those")
    corruption: float = Field(default=0.0, ge=0.0, le=1.0, description="probability of one flipped bit")

    @model_validator(mode="after")
    def _tail_is_a_range(self) -> "DirectionConfig":
        if self.tail_max_s < self.tail_min_s:
            raise ValueError(f"tail_max_s {self.tail_max_s:g} is below tail_min_s {self.tail_min_s:g}")
        return self


class RadioConfig(ConfigRecord):
    """Both directions of the radio. The key `both` gives values to both; those of `up` and `down` win over it."""

    up: DirectionConfig = DirectionConfig()
    down: DirectionConfig = DirectionConfig()

    @model_validator(mode="before")
    @classmethod
    def _both(cls, tree: Any) -> Any:
        both = tree.get("both") if isinstance(tree, Mapping) else None
        if not isinstance(both, Mapping):
            return tree
        directions = {name: merge({name: both}, {name: tree.get(name, {})})[name] for name in DIRECTIONS}
        return {name: value for name, value in tree.items() if name != "both"} | directions


OUTCOMES: Final[tuple[str, ...]] = ("delivered", "loss", "burst", "blackout", "queue")


class Delivery(NamedTuple):
    """What became of one datagram. Delays are -1 where there was no such copy, bits -1 where none was flipped."""

    sent_ns: int
    size_bytes: int
    outcome: str
    """One of OUTCOMES."""
    delay_ns: int
    copy_delay_ns: int
    flipped_bit: int


DELIVERY: Final = RecordType(
    "radio/delivery",
    (
        ("direction", ""),
        ("sent_ns", "ns"),
        ("size_bytes", "B"),
        ("outcome", ""),
        ("delay_ns", "ns"),
        ("copy_delay_ns", "ns"),
        ("flipped_bit", ""),
    ),
)
"""A delivery as a record of the flight log: indices into DIRECTIONS and OUTCOMES, the rest as in Delivery."""


def delivery_vector(direction: Direction, delivery: Delivery) -> NDArray[np.float64]:
    """The vector of a delivery, fields as in DELIVERY."""
    outcome = OUTCOMES.index(delivery.outcome)
    numbers = (DIRECTIONS.index(direction), delivery.sent_ns, delivery.size_bytes, outcome, *delivery[3:])
    return np.array(numbers, dtype=np.float64)


def delivery_from_vector(vector: Sequence[float] | NDArray[np.float64]) -> tuple[Direction, Delivery]:
    """The reverse of `delivery_vector`."""
    direction, sent_ns, size_bytes, outcome, *delays = (int(number) for number in vector)
    return DIRECTIONS[direction], Delivery(sent_ns, size_bytes, OUTCOMES[outcome], *delays)


@dataclass(slots=True)
class DirectionCounts:
    """Running counts of one direction."""

    sent: int = 0
    sent_bytes: int = 0
    delivered: int = 0
    """Datagrams handed over at least once, corrupted ones included."""
    lost: int = 0
    duplicated: int = 0
    corrupted: int = 0
    outcomes: Counter[str] = field(default_factory=Counter)


class _Luck:
    """Uniform numbers in [0, 1), _DRAWS for each datagram, drawn in blocks for speed."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._rows: deque[list[float]] = deque()

    def row(self) -> list[float]:
        if not self._rows:
            self._rows.extend(self._rng.random((_BLOCK, _DRAWS)).tolist())
        return self._rows.popleft()


class RecordedDeliveries:
    """One direction's deliveries of an earlier flight, dealt out to the datagrams of another.

    Both are walked in the order of time: a datagram meets the next delivery, unless that lies more than SLACK_NS away.
    Deliveries whose time has passed are skipped; where there is none for a datagram, the one before it counts again.
    So a flight that sends at the same times meets exactly the recorded deliveries, one by one, and a flight that sends
    more or less, as with another controller, still meets each burst and each silence when the recorded one did.
    """

    SLACK_NS: Final = 100_000_000

    def __init__(self, deliveries: Sequence[Delivery]) -> None:
        self._deliveries = deliveries
        self._next = 0
        self.used = 0
        """Datagrams that met a recorded delivery of their own."""
        self.repeated = 0
        """Datagrams that shared the delivery of the one before."""

    @property
    def skipped(self) -> int:
        """Deliveries that no datagram has met, of those that came before the latest one met."""
        return self._next - self.used

    def delivery(self, size_bytes: int, now_ns: int) -> Delivery | None:
        """The delivery of a datagram sent now; None past the end of the record."""
        deliveries, count = self._deliveries, len(self._deliveries)
        if not count or now_ns > deliveries[-1].sent_ns + self.SLACK_NS:
            return None
        while self._next < count and deliveries[self._next].sent_ns < now_ns - self.SLACK_NS:
            self._next += 1
        if self._next < count and deliveries[self._next].sent_ns <= now_ns + self.SLACK_NS:
            found = deliveries[self._next]
            self._next += 1
            self.used += 1
        else:
            found = deliveries[max(self._next - 1, 0)]
            self.repeated += 1
        bits = max(8 * size_bytes, 1)
        bit = found.flipped_bit % bits if found.flipped_bit >= 0 else -1
        return found._replace(sent_ns=now_ns, size_bytes=size_bytes, flipped_bit=bit)


class _Path:
    """One direction."""

    def __init__(self, config: DirectionConfig, rng: np.random.Generator, recorded: Sequence[Delivery]) -> None:
        self._config = config
        self._luck = _Luck(rng)
        self.recording = RecordedDeliveries(recorded)
        self._in_bad_state = False
        self._free_ns = 0  # when the rate-limited sender has sent all it holds
        self._in_order_ns = 0  # arrival of the latest datagram that kept its turn
        self._heap: list[tuple[int, int, bool, bytes]] = []  # (due, running number, is a copy, datagram)
        self._pushed = 0
        self.counts = DirectionCounts()
        self.deliveries: list[Delivery] = []

    def send(self, datagram: bytes, now_ns: int, since_start_s: float) -> None:
        luck = self._luck.row()
        if len(self._heap) >= IN_FLIGHT_MAX:
            delivery = _undelivered(datagram, now_ns, "queue")
        else:
            recorded = self.recording.delivery(len(datagram), now_ns)
            delivery = self._decide(datagram, now_ns, since_start_s, luck) if recorded is None else recorded
        self._count(delivery)
        if delivery.outcome == "delivered":
            arriving = _flip(datagram, delivery.flipped_bit)
            self._push(now_ns + delivery.delay_ns, False, arriving)
            if delivery.copy_delay_ns >= 0:
                self._push(now_ns + delivery.copy_delay_ns, True, arriving)

    def due(self, now_ns: int) -> list[bytes]:
        out: list[bytes] = []
        while self._heap and self._heap[0][0] <= now_ns:
            _, _, is_copy, datagram = heapq.heappop(self._heap)
            self.counts.delivered += not is_copy
            out.append(datagram)
        return out

    def next_due_ns(self) -> int | None:
        return self._heap[0][0] if self._heap else None

    def _push(self, due_ns: int, is_copy: bool, datagram: bytes) -> None:
        heapq.heappush(self._heap, (due_ns, self._pushed, is_copy, datagram))
        self._pushed += 1

    def _count(self, delivery: Delivery) -> None:
        counts = self.counts
        counts.sent += 1
        counts.sent_bytes += delivery.size_bytes
        counts.outcomes[delivery.outcome] += 1
        counts.lost += delivery.outcome != "delivered"
        counts.duplicated += delivery.copy_delay_ns >= 0
        counts.corrupted += delivery.flipped_bit >= 0
        if len(self.deliveries) < DELIVERIES_MAX:
            self.deliveries.append(delivery)

    def _decide(self, datagram: bytes, now_ns: int, since_start_s: float, luck: list[float]) -> Delivery:
        c = self._config
        change = c.burst.leave if self._in_bad_state else c.burst.enter
        if luck[0] < change:
            self._in_bad_state = not self._in_bad_state
        left_ns = self._leave_queue(len(datagram), now_ns)
        if left_ns is None:
            return _undelivered(datagram, now_ns, "queue")
        if c.blackouts and any(
            b.start_s <= since_start_s and (b.end_s is None or since_start_s < b.end_s) for b in c.blackouts
        ):
            return _undelivered(datagram, now_ns, "blackout")
        if self._in_bad_state and luck[1] < c.burst.loss_in_bad:
            return _undelivered(datagram, now_ns, "burst")
        if luck[2] < c.loss:
            return _undelivered(datagram, now_ns, "loss")
        arrival_ns = self._arrival(left_ns, luck)
        copy_ns = arrival_ns + round(luck[7] * 1e6) - now_ns if luck[6] < c.duplication else -1
        bit = int(luck[9] * 8 * len(datagram)) if luck[8] < c.corruption and datagram else -1
        return Delivery(now_ns, len(datagram), "delivered", arrival_ns - now_ns, copy_ns, bit)

    def _leave_queue(self, size_bytes: int, now_ns: int) -> int | None:
        """When the last bit is on the air; None when the queue is full."""
        rate = self._config.rate_bit_s
        if rate is None:
            return now_ns
        waiting_ns = max(0, self._free_ns - now_ns)
        if waiting_ns * 1e-9 * rate / 8 + size_bytes > self._config.queue_bytes:
            return None
        self._free_ns = now_ns + waiting_ns + round(size_bytes * 8e9 / rate)
        return self._free_ns

    def _arrival(self, left_ns: int, luck: list[float]) -> int:
        c = self._config
        delay_s = c.delay_s - c.jitter_s * math.log1p(-luck[3])
        if luck[4] < c.tail_probability:  # the same number, stretched, says how long
            delay_s += c.tail_min_s + (c.tail_max_s - c.tail_min_s) * luck[4] / c.tail_probability
        in_turn_ns = max(self._in_order_ns, left_ns + round(delay_s * 1e9))
        if luck[5] < c.reordering:
            return in_turn_ns + round(c.reordering_delay_s * 1e9 * luck[5] / c.reordering)
        self._in_order_ns = in_turn_ns
        return in_turn_ns


class Radio:
    """Impairs the datagrams of both directions; time and randomness come from the caller.

    Parameters
    ----------
    rng: source of the two directions' own generators.
    start_ns: start of the flight, which blackouts count from; by default the time of the first datagram.
    recorded: deliveries of an earlier flight by direction, dealt out by `RecordedDeliveries`. Past their end `config`
    decides.
    """

    def __init__(
        self,
        config: RadioConfig,
        rng: np.random.Generator,
        start_ns: int | None = None,
        recorded: Mapping[Direction, Sequence[Delivery]] | None = None,
    ) -> None:
        up, down = rng.spawn(2)
        recorded = recorded or {}
        self._paths: dict[Direction, _Path] = {
            "up": _Path(config.up, up, recorded.get("up", ())),
            "down": _Path(config.down, down, recorded.get("down", ())),
        }
        self._start_ns = start_ns

    @property
    def deliveries(self) -> dict[Direction, list[Delivery]]:
        """What became of each datagram, in the order sent."""
        return {direction: path.deliveries for direction, path in self._paths.items()}

    def recording(self, direction: Direction) -> RecordedDeliveries:
        """How far the recorded deliveries were dealt out."""
        return self._paths[direction].recording

    def start(self, now_ns: int) -> None:
        """Says that the flight starts now."""
        self._start_ns = now_ns

    def send(self, direction: Direction, datagram: bytes, now_ns: int) -> None:
        """Takes a datagram to carry."""
        if self._start_ns is None:
            self._start_ns = now_ns
        self._paths[direction].send(datagram, now_ns, (now_ns - self._start_ns) * 1e-9)

    def due(self, direction: Direction, now_ns: int) -> list[bytes]:
        """The datagrams that arrive by now, in the order of their arrival."""
        return self._paths[direction].due(now_ns)

    def next_due_ns(self, direction: Direction) -> int | None:
        """When the next datagram arrives; None when nothing is on its way."""
        return self._paths[direction].next_due_ns()

    def counts(self, direction: Direction) -> DirectionCounts:
        """Running counts; sent = delivered + lost + on their way."""
        return self._paths[direction].counts


def _undelivered(datagram: bytes, now_ns: int, outcome: str) -> Delivery:
    return Delivery(now_ns, len(datagram), outcome, -1, -1, -1)


def _flip(datagram: bytes, bit: int) -> bytes:
    """`datagram` with one bit inverted; as it is when there is no such bit."""
    if not 0 <= bit < 8 * len(datagram):
        return datagram
    spoilt = bytearray(datagram)
    spoilt[bit // 8] ^= 1 << bit % 8
    return bytes(spoilt)
