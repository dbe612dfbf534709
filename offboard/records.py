"""What the offboard side logs, and what its core gives out in one step."""

from dataclasses import dataclass, field
from typing import Final

from flight_log.schema import RecordType
from offboard.training.job import TrainingJob
from protocol.conventions import Array


def _per_channel(name: str, squared: bool = True) -> tuple[tuple[str, str], ...]:
    power = "^2" if squared else ""
    return ((f"{name}_position", f"(m/s^2){power}"), (f"{name}_attitude", f"(rad/s^2){power}"))


TRAINING: Final = RecordType(
    "offboard/training",
    (
        ("round", ""),
        ("sent_version", "0 where none was sent"),
        ("flying_version", ""),
        ("verdict", "offboard.training.gate.Verdict"),
        ("training_samples", ""),
        ("validation_samples", ""),
        ("buffer_samples", ""),
        ("samples_seen", ""),
        *_per_channel("training_loss"),
        *_per_channel("validation_loss"),
        *_per_channel("test_loss"),
        *_per_channel("flying_loss"),
        *_per_channel("label_power"),
        ("lipschitz_position", ""),
        ("lipschitz_attitude", ""),
    ),
)
"""One round of training: mean squared errors summed over the axes; NaN where there is nothing to say."""

EPOCH: Final = RecordType(
    "offboard/epoch",
    (
        ("round", ""),
        ("epoch", ""),
        *_per_channel("training_loss"),
        *_per_channel("validation_loss"),
        *_per_channel("test_loss"),
    ),
)
"""The losses along a round."""

LINK: Final = RecordType(
    "offboard/link",
    (
        ("received", ""),
        ("lost", ""),
        ("duplicate", ""),
        ("rejected", ""),
        ("sent", ""),
        ("poses_relayed", ""),
        ("poses_rejected", ""),
        ("samples", ""),
        ("labels", ""),
        ("flying_version", ""),
    ),
)
"""Once a second: what came and went."""

RECORDS: Final = (TRAINING, EPOCH, LINK)

Logged = tuple[RecordType, int, Array]


@dataclass(slots=True)
class OffboardOutput:
    """What one step of the core asks the shell to do."""

    to_onboard: list[bytes] = field(default_factory=list)
    job: TrainingJob | None = None
    """To be run (off the loop where there is one) and given back with receive_training."""
    records: list[Logged] = field(default_factory=list)
    events: list[tuple[int, str]] = field(default_factory=list)
    checkpoint: bytes | None = None
    """To be written to the checkpoint file, atomically."""
    version_file: tuple[int, bytes] | None = None
    """A sent version and the bytes to keep of it."""
