"""What is learnt about one vehicle: its samples, its buffer, its networks, its versions.

A trainer of several vehicles holds one VehicleLearner for each. No bytes, no clock and no link here.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from offboard.config import OffboardConfig
from offboard.data.buffer import TRAINING, FeatureFunction, NewestRing, NoveltyBuffer, split_of_block
from offboard.data.experience import Experience, dump_experience
from offboard.data.labels import LabelledSample, LabelMaker
from offboard.training.gate import Gate, Verdict
from offboard.training.job import TrainerState, TrainingJob, TrainingResult
from offboard.training.network import InputPlan, NetworkState, feature_set, initial_state, phi, state_of
from protocol.conventions import Array
from protocol.feature_set import FeatureSet
from protocol.messages import SampleBatch

VERSIONS_REMEMBERED: Final = 16
SESSION_GAP_NS: Final = 1_000_000_000
"""Put between the samples of two flights, whose clocks have nothing to do with each other."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a round."""

    verdict: Verdict
    to_send: FeatureSet | None


class VehicleLearner:
    """Samples in, training jobs and versions out."""

    def __init__(self, config: OffboardConfig) -> None:
        self._config = config
        self._plan = InputPlan.of(config.network)
        self._labels = LabelMaker(config.labels)
        self._state = TrainerState(initial_state(config.network, np.random.default_rng([config.seed, 1])), (), 0, 0)
        self._buffer = NoveltyBuffer(config.buffer, config.network, self._feature_function(self._state.network))
        self._newest = NewestRing(config.buffer.newest)
        self._gate = Gate(config.gate, config.network.spectral_norm_max)
        self._sent: dict[int, FeatureSet] = {}
        self.latest: FeatureSet | None = None
        """The newest version sent, or loaded."""
        self.version = 0
        """The highest version number in use anywhere."""
        self.labelled = 0
        """Labelled samples so far, earlier flights of the same experience included."""
        self._labelled_at_last_job = 0
        self._training_samples = 0
        self._block = (-1, TRAINING)
        self._time_shift_ns: int | None = None
        self._last_time_ns = 0

    @property
    def samples(self) -> int:
        """Samples received and used since start."""
        return self._labels.samples

    @property
    def buffered(self) -> int:
        """Samples in the buffer."""
        return self._buffer.count

    @property
    def rounds(self) -> int:
        """Rounds of training so far."""
        return self._state.rounds

    def start_flight(self) -> None:
        """The onboard process is another one: its indices and its clock start anew."""
        self._labels.restart()
        self._time_shift_ns = None

    def receive(self, batch: SampleBatch) -> None:
        """Label, split and store."""
        for sample in self._labels.receive(batch):
            self._store(self._on_one_clock(sample))

    def _on_one_clock(self, sample: LabelledSample) -> LabelledSample:
        if self._time_shift_ns is None:
            self._time_shift_ns = max(0, self._last_time_ns + SESSION_GAP_NS - sample.time_ns) if self.labelled else 0
        self._last_time_ns = sample.time_ns + self._time_shift_ns
        return replace(sample, time_ns=self._last_time_ns)

    def _store(self, sample: LabelledSample) -> None:
        split = self._split(sample.time_ns)
        self._newest.put(sample, split)
        self._buffer.consider(sample, split)
        self.labelled += 1
        self._training_samples += split == TRAINING

    def _split(self, time_ns: int) -> int:
        config = self._config.buffer
        block = int(time_ns // round(config.block_s * 1e9))
        if block != self._block[0]:
            split = split_of_block(block, self._config.seed, config.blocks_per_group, config.groups_per_test)
            self._block = (block, split)
        return self._block[1]

    def job(self, flying_version: int) -> TrainingJob | None:
        """A round over what is there now, if there is enough and something new."""
        enough = self._training_samples >= self._config.trainer.minimum_samples
        if not enough or self.labelled == self._labelled_at_last_job:
            return None
        self._labelled_at_last_job = self.labelled
        before_ns = self._last_time_ns - round(self._config.buffer.release_s * 1e9)
        return TrainingJob(
            network_config=self._config.network,
            config=self._config.trainer,
            seed=self._config.seed,
            state=self._state,
            buffer=self._buffer.rows().released(before_ns),
            newest=self._newest.rows().released(before_ns),
            buffer_config=self._config.buffer,
            flying=self._sent.get(flying_version),
            version=self.version + 1,
            samples_seen=self.labelled,
            wire_dtype=self._config.transfer.dtype,
        )

    def receive_result(self, result: TrainingResult, now_ns: int) -> Outcome:
        """Go on from what was trained; the version to send, if the gate lets it through."""
        verdict = self._gate.judge(result.candidate, result.evidence, now_ns)
        self._state = result.state
        self._buffer.set_features(self._feature_function(result.state.network))
        if verdict is not Verdict.SEND:
            return Outcome(verdict, None)
        self._gate.note_sent(now_ns)
        return Outcome(verdict, self.issue(result.candidate))

    def note_version(self, version: int) -> None:
        """Onboard knows this version: the next one must be higher."""
        self.version = max(self.version, version)

    def issue(self, features: FeatureSet) -> FeatureSet:
        """A version under the next number, now the latest."""
        self.version += 1
        numbered = replace(features, version=self.version)
        self._sent[self.version] = numbered
        if len(self._sent) > VERSIONS_REMEMBERED:
            del self._sent[min(self._sent)]
        self.latest = numbered
        return numbered

    def _feature_function(self, network: NetworkState) -> FeatureFunction:
        features = feature_set(network, self._plan, 1, 0, 0)
        channels = [channel for channel in (features.position, features.attitude) if channel is not None]

        def stacked(signals: NDArray[np.float32]) -> Array:
            parts = [phi(channel, signals) for channel in channels]
            return np.hstack([*(part[:, :-1] for part in parts), parts[0][:, -1:]])

        return stacked

    def experience(self) -> bytes:
        """All of it as the bytes of a file."""
        return dump_experience(
            Experience(
                state=self._state,
                buffer=self._buffer.rows(),
                buffer_order=self._buffer.order,
                newest=self._newest.rows(),
                versions=tuple(self._sent.values()),
                version=self.version,
                labelled=self.labelled,
                training_samples=self._training_samples,
            )
        )

    def resume(self, experience: Experience) -> None:
        """Go on where a checkpoint stopped: same buffer, weights, optimiser, versions.

        Raises
        ------
        ValueError
            If it was made with other networks than the configured ones.
        """
        self._require_same_networks(experience.state.network)
        self._state = experience.state
        self._buffer.load(experience.buffer, experience.buffer_order)
        self._buffer.set_features(self._feature_function(self._state.network))
        self._newest.load(experience.newest)
        self._sent = {features.version: features for features in experience.versions}
        self.latest = experience.versions[-1] if experience.versions else None
        self.version = experience.version
        self.labelled = experience.labelled
        self._training_samples = experience.training_samples
        times = np.concatenate([experience.buffer.time_ns, experience.newest.time_ns])
        self._last_time_ns = int(times.max(initial=0))

    def warm_start(self, features: FeatureSet) -> None:
        """Start from an earlier version's networks, with no samples; it becomes the latest version.

        Raises
        ------
        ValueError
            If its networks are not the configured ones.
        """
        self._state = TrainerState(state_of(features, self._config.network), (), 0, 1)
        self._buffer.set_features(self._feature_function(self._state.network))
        self.latest = features

    def _require_same_networks(self, network: NetworkState) -> None:
        mine = self._state.network
        same = [W.shape for W in mine.weights] == [W.shape for W in network.weights]
        if not same or mine.last_layer.shape != network.last_layer.shape:
            raise ValueError("the experience was made with networks of another shape than the configured ones")
