"""The offboard core with real datagrams and real training, in virtual time."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from flight_log.schema import RecordType
from offboard.core import OffboardCore
from offboard.data.buffer import VALIDATION
from offboard.data.experience import load_experience
from offboard.links.pose_relay import PoseRelay
from offboard.records import EPOCH, LINK, TRAINING
from protocol.endpoint import Endpoint
from protocol.feature_config import feature_digest
from protocol.feature_set import FeatureSet
from protocol.messages import FeatureChunk, Pose, SampleBatch, Status, TimeSyncReply, TimeSyncRequest
from protocol.transfer import FeatureReceiver
from tests.offboard.flights import figure8_through_jet, offboard_config

MS = 1_000_000
START_NS = 10**9


def status(flying: int, receiver: FeatureReceiver) -> Status:
    refused, reason = receiver.refused
    return Status(
        mode=3,
        feature_version=flying,
        transfer_version=receiver.transfer_version,
        received_chunks=receiver.received_chunks,
        refused_version=refused,
        refusal=reason,
        ticks=0,
        missed_ticks=0,
        pose_age_ms=-1,
        received=0,
        lost=0,
        rejected=0,
    )


LAYOUT = feature_digest(offboard_config().features)


@dataclass
class Onboard:
    """The onboard side: sends samples and status, receives features and uses them at once."""

    session: int = 1
    flying: int = 0
    received: list[FeatureSet] = field(default_factory=list)
    poses: list[Pose] = field(default_factory=list)
    replies: list[TimeSyncReply] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.endpoint = Endpoint("onboard", self.session, None, layout=LAYOUT)
        self.receiver = FeatureReceiver()

    def receive(self, datagram: bytes, now_ns: int) -> None:
        message = self.endpoint.decode(datagram, now_ns)
        if isinstance(message, FeatureChunk):
            features = self.receiver.receive(message)
            if features is not None:
                self.received.append(features)
                self.flying = features.version
        elif isinstance(message, Pose):
            self.poses.append(message)
        elif isinstance(message, TimeSyncReply):
            self.replies.append(message)


@dataclass
class Log:
    records: list[tuple[RecordType, int, np.ndarray]] = field(default_factory=list)
    events: list[tuple[int, str]] = field(default_factory=list)
    checkpoint: bytes | None = None
    versions: dict[int, bytes] = field(default_factory=dict)

    def of(self, record_type: RecordType) -> np.ndarray:
        return np.array([vector for kind, _, vector in self.records if kind is record_type])


def fly(
    core: OffboardCore, onboard: Onboard, batches: list[SampleBatch], start_ns: int = START_NS, loss: float = 0.0
) -> Log:
    """Steps of 20 ms, a batch every 100 ms, status five times a second; a training job takes one step."""
    rng = np.random.default_rng(5)
    log, now_ns, job, pending = Log(), start_ns, None, list(batches)
    step = 0
    while pending:
        now_ns += 20 * MS
        step += 1
        if step % 5 == 0:
            core.receive_onboard(onboard.endpoint.encode(TimeSyncRequest(now_ns), now_ns), now_ns)
            datagram = onboard.endpoint.encode(pending.pop(0), now_ns)
            if rng.random() >= loss:
                core.receive_onboard(datagram, now_ns)
        if step % 10 == 0:
            core.receive_onboard(onboard.endpoint.encode(status(onboard.flying, onboard.receiver), now_ns), now_ns)
        if job is not None:
            core.receive_training(job.run(), now_ns)
        out = core.step(now_ns)
        job = out.job
        for datagram in out.to_onboard:
            if rng.random() >= loss:
                onboard.receive(datagram, now_ns)
        log.records += out.records
        log.events += out.events
        log.checkpoint = out.checkpoint or log.checkpoint
        if out.version_file is not None:
            log.versions[out.version_file[0]] = out.version_file[1]
    return log


def test_learns_a_jet_and_sends_versions_that_explain_it() -> None:
    core, onboard = OffboardCore(offboard_config(), 7, None), Onboard()
    flight = figure8_through_jet(12.0)
    log = fly(core, onboard, flight.batches(), loss=0.05)
    assert len(onboard.received) >= 3
    assert [features.version for features in onboard.received] == sorted({f.version for f in onboard.received})
    training = log.of(TRAINING)
    validation = training[:, TRAINING.names.index("validation_loss_position")]
    power = training[:, TRAINING.names.index("label_power_position")]
    assert validation[-1] < 0.35 * power[-1]
    assert len(log.of(EPOCH)) == len(training) * offboard_config().trainer.epochs
    assert len(log.of(LINK)) >= 10
    for record_type, _, vector in log.records:
        assert vector.shape == (len(record_type.fields),)
    assert set(log.versions) == {features.version for features in onboard.received}


def test_a_round_without_held_out_samples_sends_nothing() -> None:
    core = OffboardCore(offboard_config(trainer={"minimum_samples": 8}), 7, None)
    for batch in figure8_through_jet(10.0).batches():
        core.learner.receive(batch)
        job = core.learner.job(0)
        if job is not None:
            assert VALIDATION not in job.newest.split
            assert core.learner.receive_result(job.run(), START_NS).to_send is None
            return
    pytest.fail("no round")


def test_the_same_flight_gives_the_same_losses() -> None:
    batches = figure8_through_jet(4.0).batches()
    checkpoints = [fly(OffboardCore(offboard_config(), 7, None), Onboard(), batches) for _ in range(2)]
    first, second = (log.of(TRAINING) for log in checkpoints)
    assert np.array_equal(first, second, equal_nan=True)


def test_answers_time_sync_and_relays_poses_in_the_next_step() -> None:
    relay = {"latency_s": 0.008}
    core, onboard = OffboardCore(offboard_config(pose_relay=relay), 7, None), Onboard()
    core.receive_onboard(onboard.endpoint.encode(TimeSyncRequest(5 * MS), 5 * MS), 100 * MS)
    codec = mavlink.MAVLink(None, srcSystem=1)
    pose = mavlink.MAVLink_att_pos_mocap_message(80_000, [1.0, 0.0, 0.0, 0.0], 0.5, 0.25, -1.0)
    core.receive_motion_capture(bytes(pose.pack(codec)), 100 * MS)
    for datagram in core.step(102 * MS).to_onboard:
        onboard.receive(datagram, 7 * MS)
    assert [(reply.receive_ns, reply.transmit_ns) for reply in onboard.replies] == [(100 * MS, 102 * MS)]
    assert len(onboard.poses) == 1
    assert onboard.poses[0].time_ns == 92 * MS
    assert core.step(103 * MS).to_onboard == []


def test_a_step_that_comes_late_uses_the_arrival_times() -> None:
    """A stall of 30 ms between arrival and step: time sync and pose have the times of a step without it."""
    relay = {"latency_s": 0.008}
    core, onboard = OffboardCore(offboard_config(pose_relay=relay), 7, None), Onboard()
    core.step(99 * MS)
    request = onboard.endpoint.encode(TimeSyncRequest(5 * MS), 5 * MS)
    core.receive_onboard(request, 130 * MS, age_ns=30 * MS)
    pose = mavlink.MAVLink_att_pos_mocap_message(80_000, [1.0, 0.0, 0.0, 0.0], 0.5, 0.25, -1.0)
    core.receive_motion_capture(bytes(pose.pack(mavlink.MAVLink(None, srcSystem=1))), 130 * MS, age_ns=32 * MS)
    for datagram in core.step(131 * MS).to_onboard:
        onboard.receive(datagram, 36 * MS)
    assert [(reply.receive_ns, reply.transmit_ns) for reply in onboard.replies] == [(100 * MS, 131 * MS)]
    assert onboard.poses[0].time_ns == 90 * MS
    core.receive_onboard(request, 132 * MS, age_ns=40 * MS)
    assert core._clock.jumps == 0, "an arrival before the last step is no jump of the clock"


def test_one_job_at_a_time() -> None:
    core, onboard = OffboardCore(offboard_config(), 7, None), Onboard()
    core.receive_onboard(onboard.endpoint.encode(TimeSyncRequest(0), 0), 0)
    for batch in figure8_through_jet(3.0).batches():
        core.receive_onboard(onboard.endpoint.encode(batch, batch.time_ns), batch.time_ns)
    assert core.step(START_NS).job is not None
    assert core.step(START_NS + 10**10).job is None


def test_a_restarted_onboard_receives_the_latest_version_again() -> None:
    core, onboard = OffboardCore(offboard_config(), 7, None), Onboard()
    fly(core, onboard, figure8_through_jet(7.0).batches())
    assert onboard.received
    fresh = Onboard(session=2)
    idle = figure8_through_jet(2.0, seed=3).batches(first_index=10**6)
    fly(core, fresh, idle, start_ns=START_NS + 10**10)
    assert fresh.received
    assert fresh.received[0].version > onboard.flying


def test_a_restarted_core_continues_with_the_same_buffer_version_and_loss() -> None:
    flight = figure8_through_jet(14.0)
    batches = flight.batches()
    core, onboard = OffboardCore(offboard_config(), 7, None), Onboard()
    log = fly(core, onboard, batches[:80])
    saved = core.final_checkpoint()
    assert saved is not None
    again = OffboardCore(offboard_config(), 8, None)
    again.resume(saved)
    assert again.learner.experience() == saved
    assert again.learner.buffered == core.learner.buffered
    assert again.learner.version == core.learner.version
    later = fly(again, onboard, batches[80:], start_ns=START_NS + 80 * 100 * MS)
    column = TRAINING.names.index("validation_loss_position")
    before, after = log.of(TRAINING)[-1, column], later.of(TRAINING)[0, column]
    assert after < 1.5 * before + 0.02
    assert again.learner.version >= core.learner.version


def test_warm_start_in_frozen_mode_flies_what_was_loaded_and_trains_nothing() -> None:
    core, onboard = OffboardCore(offboard_config(), 7, None), Onboard()
    log = fly(core, onboard, figure8_through_jet(7.0).batches())
    frozen = offboard_config(experience={"mode": "frozen"})
    core, pilot = OffboardCore(frozen, 8, None), Onboard(session=3)
    core.warm_start(log.versions[onboard.flying])
    quiet = fly(core, pilot, figure8_through_jet(3.0).batches())
    assert len(pilot.received) == 1
    assert not quiet.of(TRAINING).size
    assert quiet.checkpoint is None
    original = onboard.received[-1].position
    loaded = pilot.received[0].position
    assert original is not None
    assert loaded is not None
    assert np.array_equal(original.last_layer, loaded.last_layer)


def test_a_version_that_cannot_be_sent_is_reported_once_and_the_core_continues() -> None:
    core, onboard = OffboardCore(offboard_config(), 7, None), Onboard()
    log = fly(core, onboard, figure8_through_jet(7.0).batches())
    flying, latest = onboard.flying, core.learner.latest
    assert latest is not None
    assert latest.position is not None
    huge = replace(latest.position, last_layer=np.full_like(latest.position.last_layer, 1e7))
    core.learner.latest = replace(latest, position=huge)
    fresh = Onboard(session=2)
    again = fly(core, fresh, figure8_through_jet(2.0, seed=3).batches(first_index=10**6), start_ns=START_NS + 10**10)
    reported = [text for _, text in again.events if "cannot be sent: a parameter of 1e+07 is too large" in text]
    assert len(reported) <= 1 + len(again.versions), "not at every step"
    assert reported
    assert flying in log.versions


def test_data_that_is_not_learnt_from_is_counted_in_log_and_summary() -> None:
    core, onboard = OffboardCore(offboard_config(labels={"attitude_limit_rad_s2": 10.0}), 7, None), Onboard()
    log = fly(core, onboard, figure8_through_jet(6.0).batches(), loss=0.05)
    unused = core.summary()["unused"]
    assert isinstance(unused, dict)
    assert unused["over_limit_attitude"] > 30
    assert unused["over_limit_position"] == 0
    assert unused["gap_position"] > 0
    last = dict(zip(LINK.names, log.of(LINK)[-1], strict=True))
    assert 0 < last["unused_over_limit_attitude"] <= unused["over_limit_attitude"]
    assert last["labels"] > 200, "the position labels are not lost with them"
    assert core.status(START_NS)["unused"] == sum(unused.values())


def test_each_flight_is_a_condition_of_its_own() -> None:
    core, onboard = OffboardCore(offboard_config(), 7, None), Onboard()
    flight = figure8_through_jet(5.0)
    fly(core, onboard, flight.batches())
    first = load_experience(core.learner.experience()).buffer
    assert not first.condition.any()
    fly(core, Onboard(session=2), figure8_through_jet(5.0, jet_m_s=0.0).batches(), start_ns=START_NS + 10**10)
    saved = core.learner.experience()
    both = load_experience(saved).buffer
    assert np.array_equal(both.take(both.condition == 0).time_ns, first.time_ns), "the jet is not overwritten by calm"
    assert (both.condition == 1).sum() > 20
    again = OffboardCore(offboard_config(), 8, None)
    again.resume(saved)
    fly(again, Onboard(session=3), flight.batches(), start_ns=START_NS + 2 * 10**10)
    assert set(load_experience(again.learner.experience()).buffer.condition.tolist()) == {0, 1, 2}


def test_poses_that_are_all_late_by_the_same_time_mean_a_clock_jump() -> None:
    relay = PoseRelay(offboard_config().pose_relay)
    codec = mavlink.MAVLink(None, srcSystem=1)

    def receive(capture_ms: int, delay_ms: int) -> Pose | None:
        north_m = 1e-4 * capture_ms
        frame = mavlink.MAVLink_att_pos_mocap_message(capture_ms * 1000, [1.0, 0.0, 0.0, 0.0], north_m, 0.25, -1.0)
        return relay.receive(bytes(frame.pack(codec)), (capture_ms + delay_ms) * MS)

    assert all(receive(10 * i, 5) for i in range(50))
    held_up = [receive(500 + 10 * i, 60 + 3 * (i % 20)) for i in range(100)]
    assert not any(held_up), "late by varying times: delayed on the way, and not relayed as if new"
    assert relay.rejected["late"] == 100
    assert receive(1500, 5) is not None
    jumped = [receive(1510 + 10 * i, 305) for i in range(100)]
    assert not any(jumped[:49])
    assert all(jumped[49:]), "all late by the same time: a clock has jumped"
    assert jumped[-1] is not None
    assert jumped[-1].time_ns == pytest.approx((1510 + 990 + 305 - 10) * MS, abs=MS)
