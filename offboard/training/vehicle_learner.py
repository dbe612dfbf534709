"""What is learnt about one vehicle: its samples, labels, buffer, networks and feature versions.

A process that trains for several vehicles has one VehicleLearner for each; they may share the networks' inner layers
(offboard.training.fleet). No bytes, clock or link in this file.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from offboard.config import OffboardConfig
from offboard.data.buffer import TRAINING, FeatureFunction, NewestRing, NoveltyBuffer, split_of_block
from offboard.data.experience import Experience, dump_experience
from offboard.data.labels import LabelledSample, LabelMaker
from offboard.memory.memory import Condition, Memory, thinned
from offboard.memory.memory_file import require_fit
from offboard.memory.recorder import FlightRecorder
from offboard.training.gate import Gate, Verdict
from offboard.training.job import TrainerState, TrainingJob, TrainingResult
from offboard.training.network import InputPlan, NetworkState, feature_set, initial_state, phi, state_of
from offboard.training.prior import NO_CONTEST
from protocol.conventions import Array
from protocol.feature_set import FeatureSet
from protocol.messages import SampleBatch
from protocol.signals import CHANNELS

VERSIONS_STORED: Final = 16
SESSION_GAP_NS: Final = 1_000_000_000
"""Inserted between the samples of two flights, whose clocks are unrelated."""


class Outcome(NamedTuple):
    """The gate's verdict on a round, and the version to send; None unless the verdict is SEND."""

    verdict: Verdict
    to_send: FeatureSet | None


class VehicleLearner:
    """Receives samples and training results; returns training jobs and feature versions."""

    def __init__(self, config: OffboardConfig) -> None:
        self._config = config
        networks = config.features.trained
        self._plan = InputPlan.of(networks)
        self._labels = LabelMaker(config.labels, networks.channels)
        self._state = TrainerState(initial_state(networks, np.random.default_rng([config.seed, 1])), (), 0, 0)
        self._buffer = NoveltyBuffer(config.buffer, networks, self._feature_function(self._state.network))
        self._newest = NewestRing(config.buffer.newest)
        self._memory: Memory | None = None
        """What the rounds start from; None from the first refusal on."""
        self._contest = NO_CONTEST
        self._recorder = FlightRecorder()
        self._gate = Gate(config.gate, networks)
        self._issued: dict[int, FeatureSet] = {}
        self.latest: FeatureSet | None = None
        """The newest version issued or loaded."""
        self.version = 0
        """The highest version number in use on either side."""
        self.labelled = 0
        """Labelled samples so far, those of earlier flights of the same experience included."""
        self.verdicts: Counter[str] = Counter()
        self.validation_losses: dict[str, float | None] = {f"validation_loss_{channel}": None for channel in CHANNELS}
        """Of the last round, (m/s^2)^2 and (rad/s^2)^2; None where the channel has no held-out sample."""
        self.newest_trained_ns = 0
        """When the newest sample of the last job was taken, onboard's clock."""
        self._labelled_at_last_job = 0
        self._training_samples = 0
        self._condition = 0
        """Number of the flight; the samples of each are a condition of their own (offboard.data.buffer)."""
        self._block = (-1, TRAINING)
        self._time_shift_ns: int | None = None
        self._last_time_ns = 0

    @property
    def samples(self) -> int:
        """Samples received and used since start."""
        return self._labels.samples

    @property
    def unused(self) -> Mapping[str, int]:
        """Samples and labels that were not used, by reason (offboard.data.labels.UNUSED)."""
        return self._labels.unused

    @property
    def buffered(self) -> int:
        """Samples in the buffer."""
        return self._buffer.count

    @property
    def rounds(self) -> int:
        """Rounds of training so far."""
        return self._state.rounds

    def counts(self) -> dict[str, int]:
        """Rounds, labelled samples and buffered samples, for status and summary."""
        return {"rounds": self.rounds, "samples": self.labelled, "buffered": self.buffered}

    def start_flight(self) -> None:
        """Another onboard process has started: sample indices and sample times begin anew."""
        self._labels.restart()
        self._condition += self.labelled > 0
        self._time_shift_ns = None

    def receive(self, batch: SampleBatch) -> None:
        """Label the samples of a batch, assign each to a split, and store it."""
        for labelled in self._labels.receive(batch):
            sample = replace(self._on_one_clock(labelled), condition=self._condition)
            split = self._split(sample.time_ns)
            self._newest.put(sample, split)
            self._recorder.put(sample)
            self._buffer.consider(sample, split)
            self.labelled += 1
            self._training_samples += split == TRAINING

    def _on_one_clock(self, sample: LabelledSample) -> LabelledSample:
        """The sample with its time shifted so that the times of successive flights increase."""
        if self._time_shift_ns is None:
            self._time_shift_ns = max(0, self._last_time_ns + SESSION_GAP_NS - sample.time_ns) if self.labelled else 0
        self._last_time_ns = sample.time_ns + self._time_shift_ns
        return replace(sample, time_ns=self._last_time_ns)

    def _split(self, time_ns: int) -> int:
        config = self._config.buffer
        block = int(time_ns // round(config.block_s * 1e9))
        if block != self._block[0]:
            split = split_of_block(block, self._config.seed, config.blocks_per_group, config.groups_per_test)
            self._block = (block, split)
        return self._block[1]

    def job(self, flying_version: int) -> TrainingJob | None:
        """A round over the samples of now; None if there are too few, or none since the last job."""
        enough = self._training_samples >= self._config.trainer.minimum_samples
        if not enough or self.labelled == self._labelled_at_last_job:
            return None
        self._labelled_at_last_job = self.labelled
        self.newest_trained_ns = self._last_time_ns - (self._time_shift_ns or 0)
        before_ns = self._last_time_ns - round(self._config.buffer.release_s * 1e9)
        return TrainingJob(
            network_config=self._config.features.trained,
            config=self._config.trainer,
            seed=self._config.seed,
            state=self._state,
            buffer=self._buffer.rows_for(self._condition).released(before_ns),
            newest=self._newest.rows().released(before_ns),
            buffer_config=self._config.buffer,
            flying=self._issued.get(flying_version),
            version=self.version + 1,
            samples_seen=self.labelled,
            wire_dtype=self._config.transfer.dtype,
            prior=None if self._memory is None else self._memory.prior,
            contest=self._contest,
            vehicle=self._config.vehicle_id,
        )

    def receive_result(self, result: TrainingResult, now_ns: int) -> Outcome:
        """Continue from the trained networks; issue a version if the gate allows it."""
        verdict = self._gate.judge(result.candidate, result.evidence, now_ns)
        self._state, self._contest = result.state, result.contest
        self._buffer.set_features(self._feature_function(result.state.network))
        self.verdicts[verdict.name.lower()] += 1
        losses = (float(loss) if np.isfinite(loss) else None for loss in result.epoch_losses[-1, 1])
        self.validation_losses = dict(zip(self.validation_losses, losses, strict=True))
        if verdict is not Verdict.SEND:
            return Outcome(verdict, None)
        self._gate.note_sent(now_ns)
        return Outcome(verdict, self.issue(result.candidate))

    def note_versions(self, *versions: int) -> None:
        """Onboard knows these versions: the next number must be higher."""
        self.version = max(self.version, *versions)

    def refuse(self, version: int) -> None:
        """Onboard refused this version, 0 for none: it is never sent again. The newest other one is the latest.

        From then on the flight's own networks are the candidates, as without a memory: the next refit of its inner
        layers would be much the same, and refused as well.
        """
        self._issued.pop(version, None)
        if version:
            self._memory = None
        if version and self.latest is not None and self.latest.version == version:
            self.latest = self._issued[max(self._issued)] if self._issued else None

    def issue(self, features: FeatureSet) -> FeatureSet:
        """Give the features the next version number; they are then the latest version."""
        self.version += 1
        numbered = replace(features, version=self.version)
        self._issued[self.version] = numbered
        if len(self._issued) > VERSIONS_STORED:
            del self._issued[min(self._issued)]
        self.latest = numbered
        return numbered

    def _feature_function(self, network: NetworkState) -> FeatureFunction:
        channels = feature_set(network, self._plan, 1, 0, 0).channels

        def stacked(signals: NDArray[np.float32]) -> Array:
            parts = [phi(channel, signals) for channel in channels]
            return np.hstack([*(part[:, :-1] for part in parts), parts[0][:, -1:]])

        return stacked

    def experience(self) -> bytes:
        """Everything that was learnt, as the bytes of a file."""
        return dump_experience(
            Experience(
                state=self._state,
                buffer=self._buffer.rows(),
                buffer_order=self._buffer.order,
                newest=self._newest.rows(),
                versions=tuple(self._issued.values()),
                version=self.version,
                labelled=self.labelled,
                training_samples=self._training_samples,
            )
        )

    def resume(self, experience: Experience) -> None:
        """Continue where a checkpoint was made: with the same buffer, weights, optimiser and versions.

        Raises
        ------
        ValueError
            If the checkpoint was made with networks of another shape than the configured ones.
        """
        self._require_same_networks(experience.state.network)
        self._state = experience.state
        self._buffer.load(experience.buffer, experience.buffer_order)
        self._buffer.set_features(self._feature_function(self._state.network))
        self._newest.load(experience.newest)
        self._issued = {features.version: features for features in experience.versions}
        self.latest = experience.versions[-1] if experience.versions else None
        self.version = experience.version
        self.labelled = experience.labelled
        self._training_samples = experience.training_samples
        times = np.concatenate([experience.buffer.time_ns, experience.newest.time_ns])
        self._last_time_ns = int(times.max(initial=0))
        conditions = np.concatenate([experience.buffer.condition, experience.newest.condition])
        self._condition = int(conditions.max(initial=0))

    def warm_start(self, features: FeatureSet) -> None:
        """Start from the networks of an earlier version, with no samples; it is then the latest version.

        Raises
        ------
        ValueError
            If its networks are not the configured ones.
        """
        self._state = TrainerState(state_of(features, self._config.features.trained), (), 0, 1)
        self._buffer.set_features(self._feature_function(self._state.network))
        self.latest = features

    def recall(self, memory: Memory) -> None:
        """Start from a memory: its inner layers and theta are the latest version, and an entrant of every round.

        A channel of which theta is zero, because its conditions share nothing, is left out of that version: inner
        layers alone are no better than the start without a memory. The networks of this flight start as they would
        without it. A memory whose inner layers have not been learnt yet changes nothing.

        Raises
        ------
        UnusableMemoryError
            If its networks are not the configured ones.
        """
        require_fit(memory.features, self._config.features.trained)
        if memory.learnt == 0:
            return
        self._memory = memory
        known = memory.version()
        position, attitude = (one if one is not None and one.last_layer.any() else None for one in known.by_channel)
        if position is not None or attitude is not None:
            self.latest = replace(known, position=position, attitude=attitude)

    def condition(self, name: str) -> Condition:
        """The flight so far as a condition of a memory."""
        return Condition(name, self._config.vehicle_id, thinned(self._recorder.samples()))

    def _require_same_networks(self, network: NetworkState) -> None:
        mine = self._state.network
        same = [W.shape for W in mine.weights] == [W.shape for W in network.weights]
        if not same or mine.last_layer.shape != network.last_layer.shape:
            raise ValueError("the experience was made with networks of another shape than the configured ones")
