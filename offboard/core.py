"""The offboard side as a block diagram: one line per block.

    datagrams -> endpoint -> samples -> labels -> buffer -> training job -> gate -> feature sender -> datagrams
    motion capture -> pose relay -> datagrams

Bytes and time in, bytes and jobs out. The shell runs a job where it likes (a thread, or inline) and gives the result
back; at most one is outstanding.
"""

from collections import Counter
from typing import Final

import numpy as np

from offboard.config import OffboardConfig
from offboard.data.experience import dump_version, load_experience, load_version
from offboard.links.pose_relay import PoseRelay
from offboard.records import EPOCH, LINK, TRAINING, OffboardOutput
from offboard.training.job import TrainingJob, TrainingResult
from offboard.training.vehicle_learner import Outcome, VehicleLearner
from protocol.clock import ForwardClock
from protocol.conventions import Array
from protocol.endpoint import Endpoint
from protocol.feature_set import FeatureSet
from protocol.messages import (
    REFUSALS,
    FeatureChunk,
    Message,
    Pose,
    SampleBatch,
    Status,
    TimeSyncReply,
    TimeSyncRequest,
)
from protocol.transfer import FeatureSender

LINK_RECORD_PERIOD_NS: Final = 1_000_000_000
RESEND_PATIENCE_NS: Final = 300_000_000
"""So long status may say that onboard has not heard of the latest version before that is sent again."""


class OffboardCore:
    """One vehicle's teacher.

    Parameters
    ----------
    session: this process's session number.
    key: pre-shared key of the link to onboard; None only between loopback addresses.
    """

    def __init__(self, config: OffboardConfig, session: int, key: bytes | None) -> None:
        self._config = config
        self._clock = ForwardClock()
        self._endpoint = Endpoint("offboard", session, key, config.vehicle_id)
        self._sender = FeatureSender(config.transfer)
        self._relay = PoseRelay(config.pose_relay)
        self._learner = VehicleLearner(config)
        self._learning = config.experience.mode == "learn"
        self._job_outstanding = False
        self._peer_session: int | None = None
        self._status: Status | None = None
        self._refused = 0
        self._unsendable = 0
        self._answers: list[tuple[int, int]] = []
        self._poses: list[Pose] = []
        self._out = OffboardOutput()
        self._behind_since_ns: int | None = None
        self._must_offer = False
        self._validation: tuple[float | None, float | None] = (None, None)
        self._verdicts: Counter[str] = Counter()
        self._next_round_ns = 0
        self._next_checkpoint_ns: int | None = None
        self._next_link_record_ns = 0

    @property
    def learner(self) -> VehicleLearner:
        """What was learnt so far."""
        return self._learner

    @property
    def endpoint(self) -> Endpoint:
        """The link to onboard, for its statistics."""
        return self._endpoint

    @property
    def flying_version(self) -> int:
        """The feature version in the air, as last reported; 0 for the random start features."""
        return 0 if self._status is None else self._status.feature_version

    def resume(self, experience: bytes) -> None:
        """Go on from the bytes of a checkpoint. Raises ExperienceError, or ValueError for other networks."""
        self._learner.resume(load_experience(experience))

    def warm_start(self, version: bytes) -> None:
        """Start from the bytes of a version or a checkpoint. Raises as `resume` does."""
        self._learner.warm_start(load_version(version))
        self._must_offer = True

    def receive_onboard(self, datagram: bytes, now_ns: int) -> None:
        """A datagram from onboard."""
        now_ns = self._clock.at(now_ns)
        message = self._endpoint.decode(datagram, now_ns)
        if self._endpoint.peer_session != self._peer_session:
            self._peer_session = self._endpoint.peer_session
            self._status = None
            self._behind_since_ns = None
            self._learner.start_flight()
            self._event(now_ns, f"onboard session {self._peer_session}")
        if message is not None:
            self._handle(message, now_ns)

    def _handle(self, message: Message, now_ns: int) -> None:
        if isinstance(message, SampleBatch):
            if self._learning:
                self._learner.receive(message)
        elif isinstance(message, Status):
            self._receive_status(message, now_ns)
        elif isinstance(message, TimeSyncRequest):
            self._answers.append((message.origin_ns, now_ns))

    def _receive_status(self, status: Status, now_ns: int) -> None:
        self._status = status
        self._sender.receive_status(status, now_ns)
        for version in (status.feature_version, status.transfer_version, status.refused_version):
            self._learner.note_version(version)
        if status.refused_version != self._refused:
            self._refused = status.refused_version
            self._event(now_ns, f"version {self._refused} refused: {REFUSALS[status.refusal]}")

    def receive_motion_capture(self, datagram: bytes, now_ns: int) -> None:
        """A datagram from the motion capture; relayed in the next step."""
        now_ns = self._clock.at(now_ns)
        pose = self._relay.receive(datagram, now_ns)
        self._out.events += self._relay.take_events()
        if pose is not None:
            self._poses.append(pose)

    def receive_training(self, result: TrainingResult, now_ns: int) -> None:
        """The result of the outstanding job."""
        now_ns = self._clock.at(now_ns)
        self._job_outstanding = False
        flying = self.flying_version
        outcome = self._learner.receive_result(result, now_ns)
        if outcome.to_send is not None:
            self._offer(outcome.to_send, now_ns)
        self._record_training(result, outcome, flying, now_ns)

    def training_failed(self, now_ns: int) -> None:
        """The outstanding job raised: go on without its result."""
        self._job_outstanding = False
        self._event(now_ns, "a round of training failed")

    def step(self, now_ns: int) -> OffboardOutput:
        """Everything that is due now."""
        now_ns = self._clock.at(now_ns)
        out, self._out = self._out, OffboardOutput()
        messages: list[Message] = [*self._poses]
        messages += [TimeSyncReply(origin_ns, receive_ns, now_ns) for origin_ns, receive_ns in self._answers]
        challenge = self._endpoint.challenge(now_ns)
        if challenge is not None:
            messages.append(challenge)
        self._poses, self._answers = [], []
        self._resend_if_behind(now_ns)
        chunks: list[FeatureChunk] = self._sender.poll(now_ns) if self._peer_session is not None else []
        messages += chunks
        out.to_onboard += [self._endpoint.encode(message, now_ns) for message in messages]
        out.job = self._next_job(now_ns)
        out.checkpoint = self._next_checkpoint(now_ns)
        self._record_link(out, now_ns)
        return out

    def _next_job(self, now_ns: int) -> TrainingJob | None:
        if not self._learning or self._job_outstanding or now_ns < self._next_round_ns:
            return None
        job = self._learner.job(self.flying_version)
        if job is not None:
            self._job_outstanding = True
            self._next_round_ns = now_ns + round(self._config.trainer.period_s * 1e9)
        return job

    def _resend_if_behind(self, now_ns: int) -> None:
        """Offer the latest version if onboard has not heard of it: a restart of either side, or a warm start."""
        latest, status = self._learner.latest, self._status
        if latest is None or latest.version == self._unsendable or status is None or self._sender.outstanding_version:
            self._behind_since_ns = None
            return
        heard_of = max(status.feature_version, status.transfer_version, status.refused_version)
        if heard_of >= latest.version and not self._must_offer:
            self._behind_since_ns = None
        elif self._behind_since_ns is None:
            self._behind_since_ns = now_ns
        elif now_ns - self._behind_since_ns >= RESEND_PATIENCE_NS:
            self._offer(self._learner.issue(latest), now_ns)

    def _offer(self, features: FeatureSet, now_ns: int) -> None:
        self._must_offer = False
        try:
            self._sender.offer(features, now_ns)
        except ValueError as error:  # a network too large for the link, by size or by its numbers: what flies goes on
            self._unsendable = features.version
            self._event(now_ns, f"version {features.version} cannot be sent: {error}")
            return
        self._behind_since_ns = None
        self._out.version_file = (features.version, dump_version(features))
        self._event(now_ns, f"version {features.version} sent, {features.samples} samples")

    def _next_checkpoint(self, now_ns: int) -> bytes | None:
        if not self._learning:
            return None
        period_ns = round(self._config.experience.checkpoint_period_s * 1e9)
        if self._next_checkpoint_ns is None:
            self._next_checkpoint_ns = now_ns + period_ns
        if now_ns < self._next_checkpoint_ns or self._learner.rounds == 0:
            return None
        self._next_checkpoint_ns = now_ns + period_ns
        return self._learner.experience()

    def final_checkpoint(self) -> bytes | None:
        """To be written when the process ends; None where nothing was learnt."""
        return self._learner.experience() if self._learning and self._learner.rounds else None

    def status(self, now_ns: int) -> dict[str, int | float | None]:
        """What a status line shows."""
        age_ns = self._endpoint.statistics.age_ns(now_ns)
        return {
            "onboard_age_ms": None if age_ns is None else age_ns // 1_000_000,
            "flying_version": self.flying_version,
            "sent_version": self._learner.version,
            "rounds": self._learner.rounds,
            "samples": self._learner.labelled,
            "buffered": self._learner.buffered,
            "poses": self._relay.relayed,
            "validation_loss_position": self._validation[0],
            "validation_loss_attitude": self._validation[1],
        }

    def summary(self) -> dict[str, object]:
        """What the flight record keeps of this side."""
        link = self._endpoint.statistics
        return {
            "version": self._learner.version,
            "rounds": self._learner.rounds,
            "samples": self._learner.labelled,
            "buffered": self._learner.buffered,
            "verdicts": dict(self._verdicts),
            "received": link.received,
            "lost": link.lost,
            "sent": link.sent,
            "rejected": dict(link.rejected),
            "poses_relayed": self._relay.relayed,
            "poses_rejected": dict(self._relay.rejected),
            "validation_loss_position": self._validation[0],
            "validation_loss_attitude": self._validation[1],
        }

    def _event(self, now_ns: int, text: str) -> None:
        self._out.events.append((now_ns, text))

    def _record_training(self, result: TrainingResult, outcome: Outcome, flying: int, now_ns: int) -> None:
        evidence, losses = result.evidence, result.epoch_losses
        self._verdicts[outcome.verdict.name.lower()] += 1
        position, attitude = (float(loss) if np.isfinite(loss) else None for loss in losses[-1, 1])
        self._validation = (position, attitude)
        channels = (result.candidate.position, result.candidate.attitude)
        nothing = np.full(2, np.nan)
        held_out = evidence.time_ns.shape[0] > 0
        training = np.concatenate(
            [
                [
                    result.state.rounds,
                    0 if outcome.to_send is None else outcome.to_send.version,
                    flying,
                    outcome.verdict,
                ],
                [result.training_samples, evidence.time_ns.shape[0], self._learner.buffered, self._learner.labelled],
                losses[-1].ravel(),
                evidence.flying_errors.mean(axis=0) if held_out else nothing,
                evidence.label_power,
                [np.nan if channel is None else channel.lipschitz_bound() for channel in channels],
            ]
        )
        self._out.records.append((TRAINING, now_ns, training))
        for epoch, loss in enumerate(losses):
            vector: Array = np.concatenate([[result.state.rounds, epoch], loss.ravel()])
            self._out.records.append((EPOCH, now_ns, vector))

    def _record_link(self, out: OffboardOutput, now_ns: int) -> None:
        if now_ns < self._next_link_record_ns:
            return
        self._next_link_record_ns = now_ns + LINK_RECORD_PERIOD_NS
        link = self._endpoint.statistics
        vector = np.array(
            [
                link.received,
                link.lost,
                link.duplicate,
                link.rejected_total,
                link.sent,
                self._relay.relayed,
                sum(self._relay.rejected.values()),
                self._learner.samples,
                self._learner.labelled,
                self.flying_version,
            ],
            dtype=np.float64,
        )
        out.records.append((LINK, now_ns, vector))
