"""Both cores' links to offboard, side by side: what one does, the other must do, and their states must agree."""

import hashlib
from functools import lru_cache
from typing import Any

import numpy as np

from experiments.flights.scenario import Choices, resolve
from onboard.c.config_table import image
from onboard.c.event_text import link_text
from onboard.config import OnboardConfig
from onboard.control.feature_reception import ReceptionStatus
from onboard.flight.modes import FlightMode
from onboard.links.offboard import DatedPose, OffboardLink, PeerRestarted
from protocol.codec import HEADER
from protocol.conventions import NEVER_NS
from protocol.messages import VERSION_MAX, FeatureChunk, SampleBatch
from protocol.statistics import REJECTIONS
from tests.onboard.c import wire
from tests.onboard.c.parity import octets, octets_of, view

KEY = bytes(range(32))
SESSION = 7 << 40
INT64_MAX, INT64_MIN = 2**63 - 1, -(2**63)
DELAYS = ("delay_ns", "delay_max_ns")


@lru_cache(maxsize=1)
def onboard_config() -> OnboardConfig:
    return resolve("figure8_wind", Choices(controller="dmrac")).onboard


def clipped(number: int) -> int:
    """The nearest number of 64 bits: where numpy's core has a larger one, C's ends."""
    return min(max(number, INT64_MIN), INT64_MAX)


def agree(ours: Any, theirs: Any, rtol: float) -> bool:
    """Whether two results or states are equal, fractions within rtol."""
    if isinstance(theirs, dict):
        return ours.keys() == theirs.keys() and all(agree(ours[name], theirs[name], rtol) for name in theirs)
    if isinstance(theirs, list | tuple):
        return len(ours) == len(theirs) and all(agree(a, b, rtol) for a, b in zip(ours, theirs, strict=True))
    return bool(ours == theirs or (type(theirs) is float and abs(ours - theirs) <= rtol * abs(theirs)))


class Link:
    """C's link behind the functions of numpy's."""

    def __init__(self, core: Any, config: OnboardConfig, session: int, key: bytes | None) -> None:
        self.core, self.c = core, core.OffboardLink()
        packed, decoded = image(config), core.CoreConfig()
        assert core.config_decode(octets(packed), len(packed), decoded)
        taken = core.offboard_link_init(self.c, decoded, session, octets(key or b""), len(key or b""))
        assert taken
        self._out, self._received = (core.Datagram * 2)(), core.Received()

    def receive(self, datagram: bytes, now_ns: int) -> list[Any]:
        """What numpy's link returns, as plain tuples."""
        self.core.offboard_link_receive(self.c, octets(datagram), len(datagram), now_ns, self._received)
        out, found = self._received, []
        if out.peer_restarted:
            found.append("restarted")
        if out.has_pose:
            values = np.float32(out.pose.pose.position).tobytes(), np.float32(out.pose.pose.quaternion).tobytes()
            found.append((*values, out.pose.taken_ns, out.pose.arrival_ns, out.pose.time_sigma_s))
        if out.has_chunk:
            found.append(wire.chunk_of(out.chunk))
        return found

    def time_sync(self, now_ns: int) -> list[bytes]:
        count = self.core.offboard_link_time_sync(self.c, now_ns, self._out[0])
        return [self._bytes(index) for index in range(count)]

    def status(
        self, now_ns: int, mode: FlightMode, ticks: tuple[int, int], last_pose_ns: int, reception: ReceptionStatus
    ) -> bytes:
        status = self.core.Status(mode=int(mode), feature_version=reception.version)
        status.ticks, status.missed_ticks = ticks
        for name in ("transfer_version", "refused_version", "refusal"):
            setattr(status, name, getattr(reception, name))
        status.received_chunks_size = len(reception.received_chunks)
        view(status.received_chunks)[: len(reception.received_chunks)] = list(reception.received_chunks)
        assert self.core.offboard_link_status(self.c, status, last_pose_ns, now_ns, self._out[0])
        return self._bytes(0)

    def encode(self, batch: SampleBatch, now_ns: int) -> bytes:
        assert self.core.offboard_link_batch(self.c, wire.to_c(self.core, batch), now_ns, self._out[0])
        return self._bytes(0)

    def clock_record(self, now_ns: int) -> list[float] | None:
        exchange = self.core.ClockExchange()
        due = self.core.offboard_link_clock_record(self.c, now_ns, exchange)
        return [float(exchange.offset_ns), float(exchange.round_trip_ns)] if due else None

    def take_events(self) -> list[tuple[int, str]]:
        events = (self.core.LinkEvent * 16)()
        count = self.core.offboard_link_take_events(self.c, events[0])
        return [(event.time_ns, link_text(event)) for event in events[:count]]

    def _bytes(self, index: int) -> bytes:
        return octets_of(self._out[index].bytes)[: self._out[index].size]


def state_of_numpy(link: OffboardLink) -> dict[str, Any]:
    """Everything that a link remembers."""
    end, s = link.endpoint, link.statistics
    peer, clock, window = end._peer, end._clock, end._peer.window
    names = ("sent", "sent_bytes", "received", "received_bytes", "lost", "duplicate", "reordered", "sessions")
    return {
        **{name: getattr(s, name) for name in (*names, "longest_gap_ns", "delay_mean_ns")},
        **{name: clipped(getattr(s, name)) for name in DELAYS},
        "rejected": {reason: count for reason, count in s.rejected.items() if count},
        "last_received": s.last_received_ns,
        "sequence": end._sequence,
        "session": peer.current,
        "newest_session": None if peer.current is None else peer._newest,
        "window": None if peer.current is None else (window.first, window.newest, window.received, window._seen),
        "retired": list(peer._retired) if len(peer._retired) < 256 else 256,
        "open": list(clock._open),
        "exchanges": sorted(clock._samples),
        "clock": (end.clock_offset_ns, end.round_trip_ns, end.clock_jumps),
        "fastest": None if end._fastest_ns is None else clipped(end._fastest_ns),
        "allowance": (end._allowance_ns, end._allowance_at_ns),
        "peer_layout": end.peer_layout,
        "sessions_seen": (link._peer_session, link._reported_session),
        "challenge": link._challenge,
        "times": (link._next_status_ns, link._next_sync_ns, link._asked_ns, link._answered_ns),
        "record": (link._next_clock_record_ns, link.last_received_ns),
        "loss": (link._loss.share, link._loss._last_share, link._loss._ends_ns, link._loss._received, link._loss._lost),
    }


def _if(known: bool, value: Any) -> Any:
    return value if known else None


def state_of_c(link: Any) -> dict[str, Any]:
    """The same of C's OffboardLink."""
    end = link.endpoint
    s, peer, clock, window = end.statistics, end.peer, end.clock, end.peer.window
    names = ("sent", "sent_bytes", "received", "received_bytes", "lost", "duplicate", "reordered", "sessions")
    seen = sum(word << 64 * index for index, word in enumerate(window.seen))
    exchanges = [(one.round_trip_ns, one.offset_ns) for one in clock.exchanges[: clock.count]]
    known = clock.count > 0
    return {
        **{name: getattr(s, name) for name in (*names, "longest_gap_ns", "delay_mean_ns", *DELAYS)},
        "rejected": {reason: count for reason, count in zip(REJECTIONS, s.rejected, strict=True) if count},
        "last_received": _if(s.last_received_ns != NEVER_NS, s.last_received_ns),
        "sequence": end.sequence,
        "session": _if(peer.started, peer.current),
        "newest_session": _if(peer.started, peer.newest),
        "window": _if(peer.started, (window.first, window.newest, window.received, seen)),
        "retired": list(peer.retired[: peer.retired_count]) if peer.retired_count < 256 else 256,
        "open": list(clock.open[: clock.open_count]),
        "exchanges": sorted(exchanges),
        "clock": (_if(known, clock.best.offset_ns), _if(known, clock.best.round_trip_ns), clock.jumps),
        "fastest": _if(end.has_fastest, end.fastest_ns),
        "allowance": (end.allowance_ns, _if(end.allowance_started, end.allowance_at_ns)),
        "peer_layout": _if(end.has_peer_layout, octets_of(end.peer_layout)),
        "sessions_seen": (
            _if(link.has_peer_session, link.peer_session),
            _if(link.has_reported_session, link.reported_session),
        ),
        "challenge": _if(link.challenged, (link.challenge_origin_ns, link.challenge_receive_ns)),
        "times": (link.next_status_ns, link.next_sync_ns, link.asked_ns, link.answered_ns),
        "record": (link.next_clock_record_ns, link.last_received_ns),
        "loss": (link.loss.share, link.loss.last_share, link.loss.ends_ns, link.loss.received, link.loss.lost),
    }


def differing(ours: dict[str, Any], theirs: dict[str, Any]) -> dict[str, Any]:
    """What of two states is not the same."""
    return {name: (ours[name], theirs[name]) for name in theirs if ours[name] != theirs[name]}


def as_plain(received: Any) -> Any:
    """One of numpy's results as `Link.receive` gives it."""
    match received:
        case PeerRestarted():
            return "restarted"
        case FeatureChunk():
            return wire.plain(received)[1:]
        case DatedPose(pose, taken_ns, arrival_ns, sigma_s):
            values = pose.position_ned_m.tobytes(), pose.quaternion.tobytes()
            return (*values, clipped(taken_ns), arrival_ns, sigma_s)


class Both:
    """The two links. Every call is made on both, and results and states are compared."""

    def __init__(
        self, core: Any, config: OnboardConfig | None = None, key: bytes | None = KEY, session: int = SESSION
    ) -> None:
        config = config or onboard_config()
        self.key, self.config = key, config
        self.rtol = 1e-6 if core.real == "float" else 0.0
        self.theirs, self.ours = OffboardLink(config, session, key), Link(core, config, session, key)
        self.same_state()

    def same_state(self) -> None:
        ours, theirs = state_of_c(self.ours.c), state_of_numpy(self.theirs)
        if self.theirs.statistics.delay_ns > INT64_MAX:  # C's ends there: continue with the same mean
            self.ours.c.endpoint.statistics.delay_mean_ns = theirs["delay_mean_ns"]
            del ours["delay_mean_ns"], theirs["delay_mean_ns"]
        assert agree(ours, theirs, self.rtol), differing(ours, theirs)

    def receive(self, datagram: bytes, now_ns: int) -> list[Any]:
        expected = [as_plain(one) for one in self.theirs.receive(datagram, now_ns)]
        assert agree(self.ours.receive(datagram, now_ns), expected, self.rtol)
        self.same_state()
        return expected

    def call(self, name: str, *arguments: Any) -> Any:
        """time_sync, status, encode, clock_record, loss_share or take_events."""
        expected = getattr(self.theirs, name)(*arguments)
        if isinstance(expected, np.ndarray):
            expected = expected.tolist()
        ours = getattr(self.ours, name)(*arguments)
        assert ours == expected, name
        self.same_state()
        return expected

    def loss_share(self, now_ns: int) -> float:
        expected = self.theirs.loss_share(now_ns)
        assert agree(self.ours.core.offboard_link_loss_share(self.ours.c, now_ns), expected, self.rtol)
        self.same_state()
        return expected

    def status(self, now_ns: int, rng: np.random.Generator) -> bytes:
        """A status of any values."""
        due = self.ours.core.offboard_link_status_due(self.ours.c, now_ns)
        assert due == self.theirs.status_due(now_ns)
        reception = ReceptionStatus(
            *(int(number) for number in rng.integers(0, VERSION_MAX, 2)),
            rng.bytes(int(rng.integers(0, 9))),
            *(int(rng.integers(0, VERSION_MAX)), int(rng.integers(0, 17))),
        )
        last_pose_ns = NEVER_NS if rng.random() < 0.3 else now_ns - int(rng.integers(-(10**9), 10**12))
        ticks = int(rng.integers(0, 2**40)), int(rng.integers(0, 300))
        return self.call("status", now_ns, FlightMode(int(rng.integers(0, 11))), ticks, last_pose_ns, reception)

    @property
    def rejected(self) -> dict[str, int]:
        return dict(self.theirs.statistics.rejected)


def sealed(key: bytes | None, header: tuple[int, ...], body: bytes) -> bytes:
    """A genuine datagram of offboard, with any content."""
    signed = HEADER.pack(*header) + body
    return signed + hashlib.blake2b(signed, digest_size=16, key=key or b"", person=b"async-dmrac down").digest()


def resealed(key: bytes | None, datagram: bytes, body: bytes | None = None, **changed: int) -> bytes:
    """A datagram with another body or header fields, and the right MAC."""
    names = ("version", "number", "vehicle_id", "session", "sequence", "sent_ns")
    header = dict(zip(names, HEADER.unpack_from(datagram), strict=True)) | changed
    return sealed(key, tuple(header.values()), datagram[HEADER.size : -16] if body is None else body)
