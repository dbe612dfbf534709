"""The radio between onboard and offboard: impairs datagrams, in real time and in lockstep.

The stages for a datagram: queue of the rate-limited sender (full: dropped), loss (blackout, burst, independent),
corruption, delay with exponential jitter and a rare long tail, duplication. A late datagram delays those behind it, so
that the order stays the same, unless reordering delays a single one. Each direction has its own generator and draws
the same number of values for each datagram: with the same seed, datagram i gets the same draws under any configuration.
The delivery of each datagram is stored and can be flown again (`RecordedDeliveries`).
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
from protocol.named_tuple import of_members

Direction = Literal["up", "down"]
"""up: onboard to offboard; down: offboard to onboard."""
DIRECTIONS: Final[tuple[Direction, Direction]] = ("up", "down")
RADIO_STREAM: Final = 301
"""The radio draws from the stream [seed, RADIO_STREAM], in real time and in lockstep."""
IN_FLIGHT_MAX: Final = 20_000
"""Datagrams on their way in one direction; with more, the queue counts as full."""
DELIVERIES_MAX: Final = 1_000_000
"""Deliveries stored per direction, more than an hour of flight; later ones are only counted."""
_DRAWS: Final = 10
_BLOCK: Final = 128


class BlackoutConfig(ConfigRecord):
    """A window without any delivery."""

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
    """Impairments of one direction."""

    delay_s: float = Field(default=0.0, ge=0.0, le=10.0, description="s, least one-way delay")
    jitter_s: float = Field(default=0.0, ge=0.0, le=10.0, description="s, mean of the exponential delay on top")
    tail_probability: float = Field(
        default=0.0, ge=0.0, le=1.0, description="share of datagrams with a long extra delay"
    )
    tail_min_s: float = Field(default=0.04, ge=0.0, le=10.0, description="s, least extra delay of those")
    tail_max_s: float = Field(default=0.1, ge=0.0, le=10.0, description="s, greatest extra delay of those")
    rate_bit_s: float | None = Field(default=None, gt=0.0, description="bit/s; null: unlimited")
    queue_bytes: int = Field(
        default=16_384, ge=1200, description="bytes that the rate-limited sender queues; more are dropped"
    )
    loss: float = Field(default=0.0, ge=0.0, le=1.0, description="independent loss probability")
    burst: BurstConfig = BurstConfig()
    blackouts: tuple[BlackoutConfig, ...] = Field(default=(), description="windows without any delivery")
    duplication: float = Field(default=0.0, ge=0.0, le=1.0, description="probability of a second copy")
    reordering: float = Field(default=0.0, ge=0.0, le=1.0, description="probability of arriving out of order")
    reordering_delay_s: float = Field(default=0.02, ge=0.0, le=10.0, description="s, greatest extra delay of those")
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
    """The delivery of one datagram. A delay is -1 without such a copy, a bit -1 if none was flipped."""

    sent_ns: int
    size_bytes: int
    outcome: str
    """One of OUTCOMES."""
    delay_ns: int
    copy_delay_ns: int
    flipped_bit: int


_delivery: Final = of_members(Delivery)

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
    delivered: int = 0
    """Datagrams delivered at least once, corrupted ones included."""
    lost: int = 0
    duplicated: int = 0
    corrupted: int = 0
    outcomes: Counter[str] = field(default_factory=Counter)


class _Draws:
    """Uniform draws from [0, 1), _DRAWS for each datagram, in blocks for speed."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._rows: deque[list[float]] = deque()

    def row(self) -> list[float]:
        if not self._rows:
            self._rows.extend(self._rng.random((_BLOCK, _DRAWS)).tolist())
        return self._rows.popleft()


class RecordedDeliveries:
    """Gives the datagrams of a flight the deliveries of an earlier one, in one direction.

    A datagram gets the next delivery in time if that is no more than SLACK_NS away. Deliveries whose time has passed
    are skipped. A datagram without a delivery gets that of the datagram before it. A flight that sends at the same
    times thus gets exactly the recorded deliveries. A flight that sends more or less, for example with another
    controller, gets each burst and each silence at the recorded time.
    """

    SLACK_NS: Final = 100_000_000

    def __init__(self, deliveries: Sequence[Delivery]) -> None:
        self._deliveries = deliveries
        self._next = 0
        self.used = 0
        """Datagrams with their own recorded delivery."""
        self.repeated = 0
        """Datagrams that got the delivery of the one before."""

    @property
    def skipped(self) -> int:
        """Deliveries without a datagram, up to the latest one used."""
        return self._next - self.used

    def delivery(self, size_bytes: int, now_ns: int) -> Delivery | None:
        """The delivery of a datagram sent now; None after the end of the recording."""
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
        self._draws = _Draws(rng)
        self.recording = RecordedDeliveries(recorded)
        self._recorded = bool(recorded)
        self._in_bad_state = False
        self._free_ns = 0  # when the queue of the rate-limited sender is empty
        self._in_order_ns = 0  # arrival of the latest datagram that was not reordered
        self._heap: list[tuple[int, int, bool, bytes]] = []  # (due, running number, is a copy, datagram)
        self._pushed = 0
        self.counts = DirectionCounts()
        self.deliveries: list[Delivery] = []

    def send(self, datagram: bytes, now_ns: int, since_start_s: float) -> None:
        draws = self._draws.row()
        if len(self._heap) >= IN_FLIGHT_MAX:
            delivery = _undelivered(datagram, now_ns, "queue")
        else:
            recorded = self.recording.delivery(len(datagram), now_ns) if self._recorded else None
            delivery = self._decide(datagram, now_ns, since_start_s, draws) if recorded is None else recorded
        self._count(delivery)
        _, _, outcome, delay_ns, copy_delay_ns, flipped_bit = delivery
        if outcome == "delivered":
            arriving = datagram if flipped_bit < 0 else _flip(datagram, flipped_bit)
            self._push(now_ns + delay_ns, False, arriving)
            if copy_delay_ns >= 0:
                self._push(now_ns + copy_delay_ns, True, arriving)

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
        _, _, outcome, _, copy_delay_ns, flipped_bit = delivery
        counts = self.counts
        counts.sent += 1
        counts.outcomes[outcome] += 1
        if outcome != "delivered":
            counts.lost += 1
        if copy_delay_ns >= 0:
            counts.duplicated += 1
        if flipped_bit >= 0:
            counts.corrupted += 1
        if len(self.deliveries) < DELIVERIES_MAX:
            self.deliveries.append(delivery)

    def _decide(self, datagram: bytes, now_ns: int, since_start_s: float, draws: list[float]) -> Delivery:
        c = self._config
        change = c.burst.leave if self._in_bad_state else c.burst.enter
        if draws[0] < change:
            self._in_bad_state = not self._in_bad_state
        left_ns = self._leave_queue(len(datagram), now_ns)
        if left_ns is None:
            return _undelivered(datagram, now_ns, "queue")
        if c.blackouts and any(
            b.start_s <= since_start_s and (b.end_s is None or since_start_s < b.end_s) for b in c.blackouts
        ):
            return _undelivered(datagram, now_ns, "blackout")
        if self._in_bad_state and draws[1] < c.burst.loss_in_bad:
            return _undelivered(datagram, now_ns, "burst")
        if draws[2] < c.loss:
            return _undelivered(datagram, now_ns, "loss")
        arrival_ns = self._arrival(left_ns, draws)
        copy_ns = arrival_ns + round(draws[7] * 1e6) - now_ns if draws[6] < c.duplication else -1
        bit = int(draws[9] * 8 * len(datagram)) if draws[8] < c.corruption and datagram else -1
        return _delivery((now_ns, len(datagram), "delivered", arrival_ns - now_ns, copy_ns, bit))

    def _leave_queue(self, size_bytes: int, now_ns: int) -> int | None:
        """When the last bit is sent; None if the queue is full."""
        rate = self._config.rate_bit_s
        if rate is None:
            return now_ns
        waiting_ns = max(0, self._free_ns - now_ns)
        if waiting_ns * 1e-9 * rate / 8 + size_bytes > self._config.queue_bytes:
            return None
        self._free_ns = now_ns + waiting_ns + round(size_bytes * 8e9 / rate)
        return self._free_ns

    def _arrival(self, left_ns: int, draws: list[float]) -> int:
        c = self._config
        delay_s = c.delay_s - c.jitter_s * math.log1p(-draws[3])
        if draws[4] < c.tail_probability:  # the same draw, scaled, gives the length
            delay_s += c.tail_min_s + (c.tail_max_s - c.tail_min_s) * draws[4] / c.tail_probability
        in_order_ns = max(self._in_order_ns, left_ns + round(delay_s * 1e9))
        if draws[5] < c.reordering:
            return in_order_ns + round(c.reordering_delay_s * 1e9 * draws[5] / c.reordering)
        self._in_order_ns = in_order_ns
        return in_order_ns


class Radio:
    """Impairs the datagrams of both directions; time and randomness come from the caller.

    Parameters
    ----------
    rng: each direction spawns its own generator from it.
    start_ns: start of the flight, from which blackouts count; by default the time of the first datagram.
    recorded: deliveries of an earlier flight by direction, see `RecordedDeliveries`. After their end `config` decides.
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
        """The delivery of each datagram, in the order sent."""
        return {direction: path.deliveries for direction, path in self._paths.items()}

    def take_deliveries(self, direction: Direction) -> list[Delivery]:
        """The deliveries since the last call, which are then forgotten: for a process that runs for hours."""
        path = self._paths[direction]
        taken, path.deliveries = path.deliveries, []
        return taken

    def recording(self, direction: Direction) -> RecordedDeliveries:
        """How many of the recorded deliveries were used."""
        return self._paths[direction].recording

    def send(self, direction: Direction, datagram: bytes, now_ns: int) -> None:
        """Receive a datagram from one end."""
        if self._start_ns is None:
            self._start_ns = now_ns
        self._paths[direction].send(datagram, now_ns, (now_ns - self._start_ns) * 1e-9)

    def due(self, direction: Direction, now_ns: int) -> list[bytes]:
        """The datagrams for the other end that have arrived by now, in order of arrival."""
        return self._paths[direction].due(now_ns)

    def next_due_ns(self, direction: Direction) -> int | None:
        """When the next datagram arrives; None if none is on its way."""
        return self._paths[direction].next_due_ns()

    def counts(self, direction: Direction) -> DirectionCounts:
        """Counts so far; sent = delivered + lost + on their way."""
        return self._paths[direction].counts


def _undelivered(datagram: bytes, now_ns: int, outcome: str) -> Delivery:
    return Delivery(now_ns, len(datagram), outcome, -1, -1, -1)


def _flip(datagram: bytes, bit: int) -> bytes:
    """`datagram` with one bit inverted; unchanged if there is no such bit."""
    if not 0 <= bit < 8 * len(datagram):
        return datagram
    corrupted = bytearray(datagram)
    corrupted[bit // 8] ^= 1 << bit % 8
    return bytes(corrupted)
