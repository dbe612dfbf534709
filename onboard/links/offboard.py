"""The link to offboard: poses, feature chunks and challenges in; samples, status and time sync out.

It decides what is sent and when. Other blocks decide whether a pose is accepted and whether features are swapped in.
"""

from typing import Final, NamedTuple

import numpy as np

from onboard.config import OnboardConfig
from onboard.control.feature_reception import ReceptionStatus
from onboard.flight.modes import FlightMode
from onboard.links.loss_rate import LossRate
from protocol.conventions import NEVER_NS, Array
from protocol.endpoint import CHALLENGE_PERIOD_NS, Endpoint
from protocol.feature_config import feature_digest
from protocol.messages import FeatureChunk, Pose, SampleBatch, Status, TimeSyncReply, TimeSyncRequest
from protocol.statistics import LinkStatistics

PEER_RESTARTED: Final = "offboard restarted"
CLOCK_RECORD_PERIOD_NS: Final = 1_000_000_000
AGE_MAX_MS: Final = 2**31 - 1
GOOD_ROUND_TRIP_NS: Final = 40_000_000
"""Up to this round trip the error of the clock offset is within the estimator's time sigma of every pose."""
ROUND_TRIP_TO_SIGMA: Final = 0.1
"""Standard deviation of the offset per second of round trip beyond GOOD_ROUND_TRIP_NS."""


class DatedPose(NamedTuple):
    """A pose and its times in the onboard clock."""

    pose: Pose
    taken_ns: int
    arrival_ns: int
    time_sigma_s: float
    """Standard deviation of `taken_ns` on a slow link; 0 on a fast one."""


class PeerRestarted(NamedTuple):
    """A new session of offboard: its versions may start at 1 again."""


Received = DatedPose | FeatureChunk | PeerRestarted


class OffboardLink:
    """Onboard's end of the link.

    Parameters
    ----------
    session: number of this run, larger at each start (protocol.session).
    key: shared with offboard; None between loopback addresses only.
    """

    def __init__(self, config: OnboardConfig, session: int, key: bytes | None) -> None:
        self.endpoint: Final = Endpoint("onboard", session, key, config.vehicle_id, feature_digest(config.features))
        self._status_period_ns = round(config.status_period_s * 1e9)
        self._sync_period_ns = round(config.time_sync_period_s * 1e9)
        self._loss = LossRate()
        self._events: list[tuple[int, str]] = []
        self._peer_session: int | None = None
        self._reported_session: int | None = None
        self._challenge: tuple[int, int] | None = None
        self._next_status_ns = 0
        self._next_sync_ns = 0
        self._asked_ns = self._answered_ns = NEVER_NS
        self._next_clock_record_ns = 0
        self.last_received_ns = NEVER_NS

    @property
    def statistics(self) -> LinkStatistics:
        """Counts of datagrams received, lost and rejected."""
        return self.endpoint.statistics

    def receive(self, datagram: bytes, now_ns: int) -> list[Received]:
        """The content of one datagram for the other blocks, in order; empty for anything that is not accepted."""
        message = self.endpoint.decode(datagram, now_ns)
        if message is None:
            return []
        self.last_received_ns = now_ns
        received: list[Received] = []
        self._report_layout(now_ns)
        if self.endpoint.peer_session != self._peer_session:
            received += self._begin_session(now_ns)
        match message:
            case Pose():
                offset_ns = self.endpoint.clock_offset_ns
                if offset_ns is not None:  # without it the pose has no time, and may be a recording
                    received.append(DatedPose(message, message.time_ns - offset_ns, now_ns, self._time_sigma_s()))
            case FeatureChunk():
                if self.endpoint.clock_offset_ns is not None:
                    received.append(message)
                else:  # it has not answered yet in this session, so it may be a recording
                    self.statistics.rejected["not_alive"] += 1
            case TimeSyncRequest():
                self._challenge = (message.origin_ns, now_ns)
            case _:
                pass  # a time sync reply: the endpoint has used it
        return received

    def _time_sigma_s(self) -> float:
        """The clock offset assumes equal delays in both directions; on a slow link its error is a part of the delay."""
        slow_ns = max((self.endpoint.round_trip_ns or 0) - GOOD_ROUND_TRIP_NS, 0)
        return ROUND_TRIP_TO_SIGMA * slow_ns * 1e-9

    def _report_layout(self, now_ns: int) -> None:
        """Report another layout of the peer, once per session of the peer."""
        mismatch = self.endpoint.layout_mismatch
        if mismatch and self._reported_session != self.endpoint.peer_session:
            self._reported_session = self.endpoint.peer_session
            self._events.append((now_ns, mismatch))

    def _begin_session(self, now_ns: int) -> list[Received]:
        restarted = self._peer_session is not None
        self._peer_session = self.endpoint.peer_session
        if not restarted:
            self._next_sync_ns = now_ns
            return []
        self._events.append((now_ns, PEER_RESTARTED))
        self._next_sync_ns = min(self._next_sync_ns, self._asked_ns + self._status_period_ns)
        return [PeerRestarted()]

    def take_events(self) -> list[tuple[int, str]]:
        """Return and clear the events since the last call: (time_ns, text)."""
        events, self._events = self._events, []
        return events

    def loss_share(self, now_ns: int) -> float:
        """Share of the peer's datagrams that the link loses at present."""
        return self._loss.step(self.endpoint.statistics, now_ns)

    def encode(self, message: SampleBatch | Status | TimeSyncRequest | TimeSyncReply, now_ns: int) -> bytes:
        """A message as an authenticated datagram."""
        return self.endpoint.encode(message, now_ns)

    def time_sync(self, now_ns: int) -> list[bytes]:
        """Our own request and the answer to a challenge, each when due: a peer cannot make us send more."""
        datagrams: list[bytes] = []
        if self._challenge is not None and now_ns - self._answered_ns >= CHALLENGE_PERIOD_NS:
            origin_ns, receive_ns = self._challenge
            self._challenge, self._answered_ns = None, now_ns
            datagrams.append(self.encode(TimeSyncReply(origin_ns, receive_ns, now_ns), now_ns))
        if now_ns >= self._next_sync_ns:
            self._asked_ns = now_ns
            known = self.endpoint.clock_offset_ns is not None  # no pose can be used before: ask with each status
            self._next_sync_ns = now_ns + (self._sync_period_ns if known else self._status_period_ns)
            datagrams.append(self.encode(TimeSyncRequest(now_ns), now_ns))
        return datagrams

    def clock_record(self, now_ns: int) -> Array | None:
        """Clock offset and round trip, ns, when due for the log: they put the logs of both sides on one time base."""
        offset_ns = self.endpoint.clock_offset_ns
        if offset_ns is None or now_ns < self._next_clock_record_ns:
            return None
        self._next_clock_record_ns = now_ns + CLOCK_RECORD_PERIOD_NS
        return np.array([offset_ns, self.endpoint.round_trip_ns], dtype=np.float64)

    def status_due(self, now_ns: int) -> bool:
        """Whether it is time for a status."""
        return now_ns >= self._next_status_ns

    def status(
        self, now_ns: int, mode: FlightMode, ticks: tuple[int, int], last_pose_ns: int, reception: ReceptionStatus
    ) -> bytes:
        """The vehicle's status as a datagram; the next is due a period later. ticks: flown and missed."""
        self._next_status_ns = now_ns + self._status_period_ns
        statistics = self.endpoint.statistics
        never = last_pose_ns == NEVER_NS
        status = Status(
            mode=int(mode),
            feature_version=reception.version,
            transfer_version=reception.transfer_version,
            received_chunks=reception.received_chunks,
            refused_version=reception.refused_version,
            refusal=reception.refusal,
            ticks=ticks[0],
            missed_ticks=ticks[1],
            pose_age_ms=-1 if never else min(max((now_ns - last_pose_ns) // 1_000_000, 0), AGE_MAX_MS),
            received=statistics.received,
            lost=statistics.lost,
            rejected=statistics.rejected.total(),
        )
        return self.encode(status, now_ns)
