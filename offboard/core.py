"""The offboard side as a block diagram: each method has one line per block, with its inputs and its outputs.

    datagrams -> endpoint -> learner: labels -> buffer -> training job -> gate -> version sender -> datagrams
    motion capture -> pose relay -> datagrams

Bytes and time in, bytes and training jobs out. The process runs a job where it likes (in its background thread, or at
once) and returns the result; there is at most one job at a time.
"""

from dataclasses import dataclass, field
from typing import Final

from offboard.config import OffboardConfig
from offboard.data.experience import dump_version, load_experience, load_version
from offboard.links.pose_relay import PoseRelay
from offboard.links.version_sender import VersionSender
from offboard.memory.memory_file import load_memory
from offboard.records import Logged, link_record, training_records
from offboard.training.fleet import Fleet, FleetJob
from offboard.training.job import TrainingJob, TrainingResult
from offboard.training.vehicle_learner import VehicleLearner
from protocol.clock import ForwardClock
from protocol.endpoint import Endpoint
from protocol.feature_config import feature_digest
from protocol.feature_set import FeatureSet
from protocol.mavlink.signing import SigningClock
from protocol.messages import Message, Pose, SampleBatch, Status, TimeSyncReply, TimeSyncRequest
from protocol.session import session_start_ns

LINK_RECORD_PERIOD_NS: Final = 1_000_000_000
GATHER_NS: Final = 20_000_000
"""Two steps of the process: the vehicles of a fleet ask for a round within it, and one round serves them all."""


@dataclass(slots=True)
class OffboardOutput:
    """What one step of the core asks the process to do."""

    to_onboard: list[bytes] = field(default_factory=list)
    job: TrainingJob | FleetJob | None = None
    """To be run outside the loop; its result goes to `receive_training`."""
    records: list[Logged] = field(default_factory=list)
    events: list[tuple[int, str]] = field(default_factory=list)
    """Time in ns and text, for the log."""
    checkpoint: bytes | None = None
    """To be written to the checkpoint file, atomically."""
    version_file: tuple[int, bytes] | None = None
    """Number and bytes of a version that was sent, to be written to its own file."""


VERSIONS_ABOVE_MAX: Final = 16
"""Versions above those that were sent which a status may name."""


class OffboardCore:
    """Learns the features of one vehicle and relays its poses.

    Parameters
    ----------
    session: this process's session number.
    key: pre-shared key of the link to onboard; None only between loopback addresses.
    capture_key: of the motion capture's MAVLink; None: unsigned.
    fleet: the vehicles to share the networks with, if the configuration says so (`trainer.shared`).
    """

    def __init__(
        self,
        config: OffboardConfig,
        session: int,
        key: bytes | None,
        fleet: Fleet | None = None,
        capture_key: bytes | None = None,
    ) -> None:
        self._learning = config.experience.mode == "learn"
        self.versions_kept: Final = config.experience.versions_kept
        """Files of versions that the process keeps."""
        self._round_period_ns = round(config.trainer.period_s * 1e9)
        self._checkpoint_period_ns = round(config.experience.checkpoint_period_s * 1e9)
        self._clock = ForwardClock()
        self.endpoint: Final = Endpoint("offboard", session, key, config.vehicle_id, feature_digest(config.features))
        self.learner: Final = VehicleLearner(config)
        self._versions = VersionSender(config.transfer)
        self._capture_clock = SigningClock(session_start_ns(session))
        self._relay = PoseRelay(config.pose_relay, capture_key, self._capture_clock)
        self.screens: Final = self._relay.screen, self.endpoint.screen
        """Sort the datagrams of a flood without counting them: of the motion capture, and of onboard."""
        self._peer_session: int | None = None
        self._known_session: int | None = None
        self._reported_version = self._version_base = 0
        self._reported_session: int | None = None
        self._poses: list[Pose] = []
        self._requests: list[tuple[int, int]] = []
        """Time sync requests to answer: their origin time, and when they arrived."""
        self._job_outstanding = False
        self._next_round_ns = 0
        self._fleet = fleet if config.trainer.shared else None
        self._entered: FleetJob | None = None
        self._entered_ns = 0
        self._next_checkpoint_ns: int | None = None
        self._next_link_record_ns = 0
        self._out = OffboardOutput()

    def resume(self, experience: bytes) -> None:
        """Continue from the bytes of a checkpoint. Raises ExperienceError, or ValueError for other networks."""
        self.learner.resume(load_experience(experience))

    def warm_start(self, version: bytes) -> None:
        """Start from the bytes of a version or a checkpoint. Raises as `resume` does."""
        self.learner.warm_start(load_version(version))
        self._versions.require_sending()

    def recall(self, memory: bytes) -> None:
        """Start from the bytes of a memory. Raises UnusableMemoryError."""
        self.learner.recall(load_memory(memory))
        self._versions.require_sending()

    def receive_onboard(self, datagram: bytes, now_ns: int, age_ns: int = 0) -> None:
        """Receive a datagram from onboard, which arrived `age_ns` ago: samples, status, or a time sync message."""
        now_ns = self._clock.at(now_ns) - age_ns
        message = self.endpoint.decode(datagram, now_ns)
        if self.endpoint.peer_session != self._peer_session:
            self._start_session(now_ns)
        if isinstance(message, SampleBatch) and self._learning:
            self._start_with_fleet()
            self.learner.receive(message)
        elif isinstance(message, Status) and self._knows_versions(message, now_ns):
            event = self._versions.receive(message, now_ns)
            self.learner.note_versions(message.feature_version, message.transfer_version, message.refused_version)
            if event:
                self._out.events.append((now_ns, event))
                self.learner.refuse(message.refused_version)
        elif isinstance(message, TimeSyncRequest):
            self._requests.append((message.origin_ns, now_ns))
            self._report_layout(now_ns)

    def _knows_versions(self, status: Status, now_ns: int) -> bool:
        """Whether a status names only versions that can be; others must not be learnt, because numbers go on from them.

        The first status of a session may name any, of a trainer that has ended; a later one none that is far above what
        was sent: only a little above is what somebody else with the key may have sent.
        """
        named = max(status.feature_version, status.transfer_version, status.refused_version)
        if self._known_session == self._peer_session and named > self._version_base + VERSIONS_ABOVE_MAX:
            self.endpoint.statistics.rejected["version_not_sent"] += 1
            if self._reported_version != named:
                self._reported_version = named
                self._event(now_ns, f"onboard names version {named}, which was never sent: status refused")
            return False
        if self._known_session != self._peer_session:
            self._known_session = self._peer_session
            self._version_base = max(self.learner.version, named)
        return True

    def _start_with_fleet(self) -> None:
        """Start a vehicle that has learnt nothing yet with the inner layers of the fleet, once there are any."""
        if self._fleet is None or self.learner.latest is not None or self.learner.labelled:
            return
        features = self._fleet.start()
        if features is not None:
            self.learner.warm_start(features)
            self._versions.require_sending()

    def _report_layout(self, now_ns: int) -> None:
        """Report another layout of onboard, once per session of onboard."""
        mismatch = self.endpoint.layout_mismatch
        if mismatch and self._reported_session != self._peer_session:
            self._reported_session = self._peer_session
            self._event(now_ns, mismatch)

    def _start_session(self, now_ns: int) -> None:
        """Another onboard process has taken the place of the one before."""
        self._peer_session = self.endpoint.peer_session
        self._versions.restart()
        self.learner.start_flight()
        self._event(now_ns, f"onboard session {self._peer_session}")

    def receive_motion_capture(self, datagram: bytes, now_ns: int, age_ns: int = 0) -> None:
        """Receive a datagram of the motion capture, which arrived `age_ns` ago; the next step sends its pose."""
        now_ns = self._clock.at(now_ns) - age_ns
        pose = self._relay.receive(datagram, now_ns)
        if pose is not None:
            self._poses.append(pose)
        if events := self._relay.take_events():
            self._out.events += events

    def receive_training(self, result: TrainingResult, now_ns: int) -> None:
        """Receive the result of the outstanding job; send its version if the gate allows it."""
        now_ns = self._clock.at(now_ns)
        self._job_outstanding = False
        learner, flying = self.learner, self._versions.flying_version
        verdict, version = learner.receive_result(result, now_ns)
        if version is not None:
            self._send_version(version, now_ns)
        sent = 0 if version is None else version.version
        counts = learner.buffered, learner.labelled, learner.newest_trained_ns
        self._out.records += training_records(result, verdict, sent, flying, *counts, now_ns)

    def training_failed(self, now_ns: int) -> None:
        """The outstanding job raised: continue without its result."""
        self._job_outstanding = False
        self._event(now_ns, "a round of training failed")

    def step(self, now_ns: int) -> OffboardOutput:
        """Run every block that is due; returns what to send, to train, to write and to log."""
        now_ns = self._clock.at(now_ns)
        self._capture_clock.now(now_ns)  # it starts here: the first pose may come much later
        messages: list[Message] = list(self._poses)
        messages += [TimeSyncReply(origin_ns, receive_ns, now_ns) for origin_ns, receive_ns in self._requests]
        if (challenge := self.endpoint.challenge(now_ns)) is not None:
            messages.append(challenge)
        self._resend_version(now_ns)
        if self._peer_session is not None:
            messages += self._versions.chunks(now_ns)
        self._poses.clear()
        self._requests.clear()
        out, self._out = self._out, OffboardOutput()
        for message in messages:
            out.to_onboard.append(self.endpoint.encode(message, now_ns))
        out.job = self._next_job(now_ns)
        out.checkpoint = self._next_checkpoint(now_ns)
        if now_ns >= self._next_link_record_ns:
            out.records.append(self._link_record(now_ns))
        return out

    def _resend_version(self, now_ns: int) -> None:
        latest = self.learner.latest
        if latest is not None and self._versions.must_resend(latest, now_ns):
            self._send_version(self.learner.issue(latest), now_ns)

    def _send_version(self, features: FeatureSet, now_ns: int) -> None:
        self._version_base = max(self._version_base, features.version)
        try:
            self._versions.send(features, now_ns)
        except ValueError as error:
            self._event(now_ns, f"version {features.version} cannot be sent: {error}")
            return
        self._out.version_file = (features.version, dump_version(features))
        self._event(now_ns, f"version {features.version} sent, {features.samples} samples")

    def _next_job(self, now_ns: int) -> TrainingJob | FleetJob | None:
        if self._entered is not None:
            return self._gathered(now_ns)
        if not self._learning or self._job_outstanding or now_ns < self._next_round_ns:
            return None
        job = self.learner.job(self._versions.flying_version)
        if job is None:
            return None
        self._job_outstanding = True
        self._next_round_ns = now_ns + self._round_period_ns
        if self._fleet is None:
            return job
        # all vehicles ask at the same times
        self._next_round_ns -= self._next_round_ns % max(self._round_period_ns, 1)
        self._entered, self._entered_ns = self._fleet.enter(job), now_ns
        return None

    def _gathered(self, now_ns: int) -> FleetJob | None:
        """The job that waits in the fleet, once the others have entered theirs."""
        if now_ns < self._entered_ns + GATHER_NS:
            return None
        entered, self._entered = self._entered, None
        return entered

    def _next_checkpoint(self, now_ns: int) -> bytes | None:
        if self._next_checkpoint_ns is None:
            self._next_checkpoint_ns = now_ns + self._checkpoint_period_ns
        checkpoint = None if now_ns < self._next_checkpoint_ns else self.final_checkpoint()
        if checkpoint is not None:
            self._next_checkpoint_ns = now_ns + self._checkpoint_period_ns
        return checkpoint

    def final_checkpoint(self) -> bytes | None:
        """The checkpoint to write when the process ends; None where nothing was learnt."""
        return self.learner.experience() if self._learning and self.learner.rounds else None

    def _link_record(self, now_ns: int) -> Logged:
        self._next_link_record_ns = now_ns + LINK_RECORD_PERIOD_NS
        poses, samples = (
            (self._relay.relayed, self._relay.rejected.total()),
            (self.learner.samples, self.learner.labelled),
        )
        flying, unused = self._versions.flying_version, self.learner.unused
        return link_record(self.endpoint.statistics, poses, samples, flying, unused, now_ns)

    def status(self, now_ns: int) -> dict[str, int | float | None]:
        """The values of a status line."""
        age_ns = self.endpoint.statistics.age_ns(now_ns)
        return {
            "onboard_age_ms": None if age_ns is None else age_ns // 1_000_000,
            "flying_version": self._versions.flying_version,
            "sent_version": self.learner.version,
            **self.learner.counts(),
            "unused": sum(self.learner.unused.values()),
            "poses": self._relay.relayed,
            **self.learner.validation_losses,
        }

    def summary(self) -> dict[str, object]:
        """What the flight summary stores of this side."""
        link = self.endpoint.statistics
        return {
            "version": self.learner.version,
            **self.learner.counts(),
            "verdicts": dict(self.learner.verdicts),
            "unused": dict(self.learner.unused),
            "received": link.received,
            "lost": link.lost,
            "sent": link.sent,
            "rejected": dict(link.rejected),
            "poses_relayed": self._relay.relayed,
            "poses_rejected": dict(self._relay.rejected),
            **self.learner.validation_losses,
        }

    def _event(self, now_ns: int, text: str) -> None:
        self._out.events.append((now_ns, text))
