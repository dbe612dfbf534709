"""One end of the link, without I/O: turns messages into authenticated datagrams, and datagrams into messages.

`decode` makes the cheap and safe checks first: length, version, type and vehicle id, then the MAC, then session and
sequence. Only then does msgpack parse the body. An invalid datagram is counted by reason and dropped; none raises. The
time that a datagram can cost is bounded (about 3 us for a forged one). Of more than
`DATAGRAMS_PER_STEP_MAX` in a step the process passes on only what `screen` finds good.
"""

from dataclasses import replace
from typing import Final, Literal

from protocol.authentication import MAC_BYTES, Authenticator
from protocol.clock import ClockEstimate
from protocol.codec import DOWN_TYPES, HEADER, PROTOCOL_VERSION, TYPE_NUMBERS, UP_TYPES, decode_body, encode_body
from protocol.errors import ProtocolError
from protocol.messages import (
    APART_MAX_NS,
    COUNTER_MAX,
    DATAGRAM_MAX_BYTES,
    NO_LAYOUT,
    FeatureChunk,
    Message,
    Pose,
    SampleBatch,
    TimeSyncReply,
    TimeSyncRequest,
)
from protocol.session import SILENCE_BEFORE_OLDER_NS, PeerSessions
from protocol.statistics import LinkStatistics

DATAGRAM_MIN_BYTES: Final = HEADER.size + 2 + MAC_BYTES
BODY_MAX_BYTES: Final = DATAGRAM_MAX_BYTES - HEADER.size - MAC_BYTES
DATAGRAMS_PER_STEP_MAX: Final = 64
"""Most datagrams that a step receives unscreened; of more, the process screens them first."""
CHALLENGE_PERIOD_NS: Final = 500_000_000
"""Least time between two challenges, so that a replayed recording cannot cause many of them."""
OTHER_SESSION: Final = 256
"""Kind of a genuine datagram of an older session."""
AHEAD_MAX_NS: Final = 86_400 * 10**9
"""A clock of the peer that steps ahead by more is not followed."""
RATE_MAX_HZ: Final = 2000
RATE_BURST: Final = 256
_TIME_SYNC: Final = (TimeSyncRequest, TimeSyncReply)
_DATED: Final = (SampleBatch, Pose)
_OF_LAYOUT: Final = (SampleBatch, FeatureChunk)
"""Kinds of messages. As tuples: an expression `A | B` would make a new object at every call."""

Role = Literal["onboard", "offboard"]


def mismatch_text(peer_layout: bytes, layout: bytes) -> str:
    """The report of a layout of the peer that is not ours."""
    return (
        f"samples and features are refused: the peer's `features` section and sample layout have digest "
        f"{peer_layout.hex()[:8]}, ours {layout.hex()[:8]}; start both sides with the same configuration"
    )


class Endpoint:
    """Encodes our messages and decodes the peer's.

    Parameters
    ----------
    role: which side this is; it determines the message types that may be sent and received.
    session: this process's session number, larger at each start (`protocol.session.session_number`).
    key: pre-shared key, 16 to 64 bytes; None only between loopback addresses.
    vehicle_id: 0 to 65535; datagrams of another vehicle are rejected.
    layout: digest of this side's features and sample layout (`protocol.feature_config.feature_digest`). Samples and
        feature chunks are rejected until the peer's time sync messages show the same one. NO_LAYOUT: no such check.

    Raises
    ------
    ValueError
        If a parameter is out of range.
    """

    def __init__(
        self, role: Role, session: int, key: bytes | None, vehicle_id: int = 1, layout: bytes = NO_LAYOUT
    ) -> None:
        if not 0 <= session < 2**64 or not 0 <= vehicle_id < 2**16:
            raise ValueError(f"session {session} or vehicle id {vehicle_id} out of range")
        onboard = role == "onboard"
        self._send = Authenticator(key, "up" if onboard else "down")
        self._receive = Authenticator(key, "down" if onboard else "up")
        self._send_types, self._receive_types = (UP_TYPES, DOWN_TYPES) if onboard else (DOWN_TYPES, UP_TYPES)
        self._session = session
        self._vehicle_id = vehicle_id
        self._sequence = 0
        self._peer = PeerSessions()
        self._clock = ClockEstimate()
        self._began_ns: int | None = None
        self._latest_ns: int | None = None
        self._fastest_ns: int | None = None
        self._allowance_ns = RATE_BURST * 10**9 // RATE_MAX_HZ
        self._allowance_at_ns: int | None = None
        self._challenge_wanted = False
        self._challenged_ns: int | None = None
        self.statistics = LinkStatistics()
        self.layout = layout
        self.peer_layout: bytes | None = None
        """None until this session of the peer has sent a time sync message."""

    @property
    def peer_session(self) -> int | None:
        """The session of the peer, which changes when the peer restarts; None before the first genuine datagram."""
        return self._peer.current

    @property
    def clock_offset_ns(self) -> int | None:
        """Peer clock minus own clock, ns; None until this session of the peer has answered a time sync request.

        A value also proves that the peer is alive and not a recording.
        """
        return self._clock.offset_ns

    @property
    def round_trip_ns(self) -> int | None:
        """Round trip time of the exchange that `clock_offset_ns` is computed from."""
        return self._clock.round_trip_ns

    @property
    def clock_jumps(self) -> int:
        """How often a jump of one of the two clocks was detected."""
        return self._clock.jumps

    @property
    def layout_mismatch(self) -> str:
        """What to report if the peer's features or sample layout differ; empty otherwise."""
        if self.peer_layout in (None, self.layout) or self.layout == NO_LAYOUT:
            return ""
        return mismatch_text(self.peer_layout, self.layout)

    def encode(self, message: Message, now_ns: int) -> bytes:
        """Encode a message as a datagram with the next sequence number.

        Raises
        ------
        ValueError
            If this role does not send such messages, or the message does not fit into a datagram.
        """
        self._note_time(now_ns)
        number = TYPE_NUMBERS[type(message)]
        if number not in self._send_types:
            raise ValueError(f"{type(message).__name__} is not sent in this direction")
        if isinstance(message, _TIME_SYNC):
            message = replace(message, layout=self.layout)
        body = encode_body(message)
        if len(body) > BODY_MAX_BYTES:
            raise ValueError(f"body of {len(body)} bytes, allowed are {BODY_MAX_BYTES}")
        header = HEADER.pack(PROTOCOL_VERSION, number, self._vehicle_id, self._session, self._sequence, now_ns)
        signed = header + body
        if type(message) is TimeSyncRequest:
            self._clock.note_request(message.origin_ns)
        self._sequence += 1
        self.statistics.sent += 1
        self.statistics.sent_bytes += len(signed) + MAC_BYTES
        return signed + self._send.mac(signed)

    def decode(self, datagram: bytes, now_ns: int) -> Message | None:
        """Decode a datagram of the peer; None if it was rejected (`statistics.rejected`) or is a duplicate."""
        self._note_time(now_ns)
        try:
            return self._decode(datagram, now_ns)
        except ProtocolError as error:
            if error.reason == "duplicate":
                self.statistics.duplicate += 1
            else:
                self.statistics.rejected[error.reason] += 1
            return None

    def screen(self, datagram: bytes) -> int:
        """The kind of a datagram: its type, or OTHER_SESSION; -1 if `decode` would refuse it. Nothing changes.

        The body is not read, and the rate is not limited.
        """
        if not DATAGRAM_MIN_BYTES <= len(datagram) <= DATAGRAM_MAX_BYTES:
            return -1
        version, number, vehicle_id, session, sequence, _ = HEADER.unpack_from(datagram)
        if version != PROTOCOL_VERSION or number not in self._receive_types or vehicle_id != self._vehicle_id:
            return -1
        if session == self._peer.current:
            if self._peer.window.verdict(sequence):
                return -1
        elif not self._peer.is_newer(session):
            number = OTHER_SESSION
        return number if self._receive.is_genuine(datagram) else -1

    def _decode(self, datagram: bytes, now_ns: int) -> Message:
        if not DATAGRAM_MIN_BYTES <= len(datagram) <= DATAGRAM_MAX_BYTES:
            raise ProtocolError("length")
        version, number, vehicle_id, session, sequence, sent_ns = HEADER.unpack_from(datagram)
        if version != PROTOCOL_VERSION:
            raise ProtocolError("version")
        if number not in self._receive_types:
            raise ProtocolError("type")
        if vehicle_id != self._vehicle_id:
            raise ProtocolError("vehicle")
        if not self._receive.is_genuine(datagram):
            raise ProtocolError("mac")
        body = datagram[HEADER.size : -MAC_BYTES]
        if session == self._peer.current:
            self._require_new(sequence)
        elif self._peer.is_newer(session) or self._answers_request(session, number, body, now_ns):
            self._start_session(session, sequence)
        else:
            self._challenge_wanted = self._peer.may_return(session) and self._is_silent(now_ns)
            raise ProtocolError("session")
        self._require_time(sent_ns, now_ns)
        self._count(sequence, sent_ns, len(datagram), now_ns)
        self._spend_allowance(now_ns)
        message = decode_body(number, body)
        if isinstance(message, _DATED) and abs(sent_ns - message.time_ns) > APART_MAX_NS:
            raise ProtocolError("value")
        if isinstance(message, _TIME_SYNC):
            self.peer_layout = message.layout
        elif self._is_of_before(sent_ns):
            raise ProtocolError("before_start")
        elif isinstance(message, _OF_LAYOUT) and self.layout not in (NO_LAYOUT, self.peer_layout):
            raise ProtocolError("layout")
        if type(message) is TimeSyncReply and not self._clock.receive_reply(
            message.origin_ns, message.receive_ns, message.transmit_ns, now_ns
        ):
            raise ProtocolError("time_sync")
        return message

    def _require_time(self, sent_ns: int, now_ns: int) -> None:
        """Refuse a sender's time that does not fit 63 bits, or is a day or more ahead of the session's clock."""
        if self._fastest_ns is not None and sent_ns - now_ns > AHEAD_MAX_NS - self._fastest_ns:
            raise ProtocolError("value")
        if sent_ns > COUNTER_MAX:
            raise ProtocolError("value")

    def _note_time(self, now_ns: int) -> None:
        """Note when this side began; not known any more after its own clock went back."""
        if self._latest_ns is None:
            self._began_ns = now_ns
        elif now_ns < self._latest_ns:
            self._began_ns = None
        self._latest_ns = now_ns

    def _is_of_before(self, sent_ns: int) -> bool:
        """Whether a datagram was sent before this side began: its sequence number may be new to us, but not to others.

        Time sync messages are exempt: they prove by themselves that they are new, and show a clock that was set back.
        """
        offset_ns, round_trip_ns = self._clock.offset_ns, self._clock.round_trip_ns
        if offset_ns is None or round_trip_ns is None or self._began_ns is None:
            return False
        return sent_ns - offset_ns + round_trip_ns // 2 < self._began_ns

    def _require_new(self, sequence: int) -> None:
        verdict = self._peer.window.verdict(sequence)
        if verdict:
            raise ProtocolError(verdict)

    def _answers_request(self, session: int, number: int, body: bytes, now_ns: int) -> bool:
        """Rule 3 of protocol.session: an older, unknown session that answers an open time sync request of this side."""
        if number != TYPE_NUMBERS[TimeSyncReply] or not self._is_silent(now_ns):
            return False
        reply = decode_body(number, body)
        fresh = type(reply) is TimeSyncReply and self._clock.is_open(reply.origin_ns, now_ns)
        return fresh and self._peer.may_return(session)

    def _is_silent(self, now_ns: int) -> bool:
        """Whether the current session of the peer has been silent for SILENCE_BEFORE_OLDER_NS."""
        silent_ns = self.statistics.age_ns(now_ns)
        return silent_ns is not None and silent_ns >= SILENCE_BEFORE_OLDER_NS

    def challenge(self, now_ns: int) -> TimeSyncRequest | None:
        """The request that an older session must answer to replace the silent one; None if there is no such session."""
        wanted, self._challenge_wanted = self._challenge_wanted, False
        if not wanted:
            return None
        if self._challenged_ns is not None and 0 <= now_ns - self._challenged_ns < CHALLENGE_PERIOD_NS:
            return None
        self._challenged_ns = now_ns
        return TimeSyncRequest(now_ns)

    def _start_session(self, session: int, sequence: int) -> None:
        self._peer.start(session, sequence)
        self._clock.restart()
        self._fastest_ns = None
        self.peer_layout = None
        self.statistics.sessions += 1

    def _count(self, sequence: int, sent_ns: int, size_bytes: int, now_ns: int) -> None:
        if self._peer.window.accept(sequence):
            self.statistics.reordered += 1
        self.statistics.lost = self._peer.lost
        apart_ns = now_ns - sent_ns
        self._fastest_ns = apart_ns if self._fastest_ns is None else min(self._fastest_ns, apart_ns)
        offset_ns = self._clock.offset_ns
        delay_ns = apart_ns - self._fastest_ns if offset_ns is None else max(0, apart_ns + offset_ns)
        self.statistics.count_received(size_bytes, delay_ns, now_ns)

    def _spend_allowance(self, now_ns: int) -> None:
        """Limit the datagrams decoded even from a genuine peer to RATE_MAX_HZ, with bursts of RATE_BURST."""
        since_ns = 0 if self._allowance_at_ns is None else max(0, now_ns - self._allowance_at_ns)
        self._allowance_at_ns = now_ns
        full_ns = RATE_BURST * 10**9 // RATE_MAX_HZ
        self._allowance_ns = min(full_ns, self._allowance_ns + since_ns)
        if self._allowance_ns < 10**9 // RATE_MAX_HZ:
            raise ProtocolError("rate")
        self._allowance_ns -= 10**9 // RATE_MAX_HZ
