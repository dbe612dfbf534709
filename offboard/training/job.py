"""A round of training as it is ordered, and what it gives back: plain records, without torch."""

from dataclasses import dataclass
from typing import Literal

from offboard.config import BufferConfig, NetworkConfig, TrainerConfig
from offboard.data.buffer import SampleTable
from offboard.training.gate import Evidence
from offboard.training.network import Array32, NetworkState
from protocol.conventions import Array
from protocol.feature_set import FeatureSet


@dataclass(frozen=True, slots=True, eq=False)
class TrainerState:
    """What one round hands to the next."""

    network: NetworkState
    moments: tuple[Array32, ...]
    """Of the optimiser, on the flat vector of parameters; empty before the first round."""
    steps: int
    """Mini-batches so far."""
    rounds: int


@dataclass(frozen=True, slots=True, eq=False)
class TrainingResult:
    """What a round found."""

    state: TrainerState
    candidate: FeatureSet
    evidence: Evidence
    epoch_losses: Array
    """[epochs, 3, 2]: training, validation, test loss per channel after each epoch, (m/s^2)^2 and (rad/s^2)^2."""
    training_samples: int


@dataclass(frozen=True, slots=True, eq=False)
class TrainingJob:
    """A round to be run: everything it reads is its own copy."""

    network_config: NetworkConfig
    config: TrainerConfig
    seed: int
    state: TrainerState
    buffer: SampleTable
    newest: SampleTable
    buffer_config: BufferConfig
    flying: FeatureSet | None
    """The version in the air, None for the random start features (whose nu_ad is not known here)."""
    version: int
    """Number the result would be sent under."""
    samples_seen: int
    wire_dtype: Literal["float16", "float32"]
    """Size of the parameters on the way up: what is judged is what will fly."""

    def run(self) -> TrainingResult:
        """Train (offboard.training.round.train). torch is loaded here: a side that learns nothing does without it."""
        from offboard.training.round import train

        return train(self)
