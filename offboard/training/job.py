"""A round of training as records, without torch: what it needs (TrainingJob) and what it returns (TrainingResult)."""

from dataclasses import dataclass
from typing import Literal, Protocol

from offboard.config import BufferConfig, TrainerConfig
from offboard.data.buffer import SampleTable
from offboard.memory.memory import Prior
from offboard.training.gate import Evidence
from offboard.training.network import Array32, NetworkConfig, NetworkState
from offboard.training.prior import NO_CONTEST, Contest, with_contest
from protocol.conventions import Array
from protocol.feature_config import TrainedFeatures
from protocol.feature_set import FeatureSet


@dataclass(frozen=True, slots=True, eq=False)
class TrainerState:
    """What one round hands to the next."""

    network: NetworkState
    moments: tuple[Array32, ...]
    """The optimiser's moments of the flat parameter vector; empty before the first round."""
    steps: int
    """Mini-batches so far."""
    rounds: int


class RoundJob(Protocol):
    """What the training of a round needs, whoever asks for it: TrainingJob for a vehicle, or another learner's own."""

    @property
    def network_config(self) -> NetworkConfig:
        """Of the networks."""

    @property
    def config(self) -> TrainerConfig:
        """Of the training."""

    @property
    def seed(self) -> int:
        """Of initial weights and mini-batches."""

    @property
    def state(self) -> TrainerState:
        """What the round before has left."""

    @property
    def buffer(self) -> SampleTable:
        """Stored samples."""

    @property
    def newest(self) -> SampleTable:
        """The newest samples, of which a mini-batch draws a share."""

    @property
    def buffer_config(self) -> BufferConfig:
        """Its `newest_fraction` and `newest_scale` say how samples are drawn."""

    @property
    def label_floors(self) -> tuple[float, ...]:
        """Least scale of the labels, of each channel of the labels."""


@dataclass(frozen=True, slots=True, eq=False)
class TrainingResult:
    """The result of a round."""

    state: TrainerState
    candidate: FeatureSet
    """The trained networks, with their parameters rounded as for sending."""
    evidence: Evidence
    epoch_losses: Array
    """[epochs, 3, 2]: training, validation, test loss per channel after each epoch, (m/s^2)^2 and (rad/s^2)^2."""
    training_samples: int
    contest: Contest = NO_CONTEST
    """With a prior: how the networks trained on this flight have done against it."""


@dataclass(frozen=True, slots=True, eq=False)
class TrainingJob:
    """A round of training to be run. Its tables are copies, which nothing else changes."""

    network_config: TrainedFeatures
    config: TrainerConfig
    seed: int
    state: TrainerState
    buffer: SampleTable
    newest: SampleTable
    buffer_config: BufferConfig
    flying: FeatureSet | None
    """The version in flight; None for the random start features (whose nu_ad is not known here)."""
    version: int
    """Number under which the result would be sent."""
    samples_seen: int
    wire_dtype: Literal["float16", "float32"]
    """Float size of the parameters on the link: the gate judges the networks as they would fly."""
    prior: Prior | None = None
    """What the flight started from; None: nothing."""
    contest: Contest = NO_CONTEST
    """Of the rounds before."""
    vehicle: int = 1
    """offboard.vehicle_id."""

    @property
    def label_floors(self) -> tuple[float, ...]:
        """m/s^2 and rad/s^2: least scale of the labels of position and attitude."""
        return self.config.position_label_floor_m_s2, self.config.attitude_label_floor_rad_s2

    def run(self) -> TrainingResult:
        """Run the round, by offboard.training.round. torch is loaded here: a process that learns nothing needs none."""
        from offboard.training.round import train

        return with_contest(self, train(self))
