"""The records that the offboard side logs: their fields, and the functions that fill them."""

from collections.abc import Mapping
from typing import Final

import numpy as np

from flight_log.schema import RecordType
from offboard.data.labels import UNUSED
from offboard.training.job import TrainingResult
from protocol.conventions import Array
from protocol.statistics import LinkStatistics

Logged = tuple[RecordType, int, Array]
"""A record: its type, time in ns, and values in the order of the type's fields."""


def _per_channel(name: str) -> tuple[tuple[str, str], ...]:
    return ((f"{name}_position", "(m/s^2)^2"), (f"{name}_attitude", "(rad/s^2)^2"))


_LOSSES: Final = (*_per_channel("training_loss"), *_per_channel("validation_loss"), *_per_channel("test_loss"))

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
        ("newest_sample", "s, onboard's clock, of the newest sample trained on"),
        *_LOSSES,
        *_per_channel("flying_loss"),
        *_per_channel("label_power"),
        ("lipschitz_position", ""),
        ("lipschitz_attitude", ""),
    ),
)
"""One round of training. Losses are mean squared errors, summed over the axes; NaN where there is no value."""

EPOCH: Final = RecordType("offboard/epoch", (("round", ""), ("epoch", ""), *_LOSSES))
"""The losses after each epoch of a round."""

_POSES_AND_SAMPLES: Final = ("poses_relayed", "poses_rejected", "samples", "labels", "flying_version")
LINK: Final = RecordType(
    "offboard/link",
    tuple(
        (name, "")
        for name in (
            *("received", "lost", "duplicate", "rejected", "sent"),
            *_POSES_AND_SAMPLES,
            *(f"unused_{reason}" for reason in UNUSED),
        )
    ),
)
"""Once a second: counts of datagrams, poses and samples since start; `unused`: see offboard.data.labels.UNUSED."""

RECORDS: Final = (TRAINING, EPOCH, LINK)


def training_records(
    result: TrainingResult,
    verdict: int,
    sent_version: int,
    flying_version: int,
    buffered: int,
    labelled: int,
    newest_ns: int,
    now_ns: int,
) -> list[Logged]:
    """The TRAINING record of a round, and an EPOCH record for each of its epochs."""
    evidence, losses, rounds = result.evidence, result.epoch_losses, result.state.rounds
    held_out = evidence.time_ns.shape[0]
    channels = result.candidate.by_channel
    training = np.concatenate(
        [
            [rounds, sent_version, flying_version, verdict],
            [result.training_samples, held_out, buffered, labelled, newest_ns * 1e-9],
            losses[-1].ravel(),
            [_mean_of_known(errors) for errors in evidence.flying_errors.T],
            evidence.label_power,
            [np.nan if channel is None else channel.lipschitz_bound() for channel in channels],
        ]
    )
    epochs = [(EPOCH, now_ns, np.array([rounds, epoch, *loss.ravel()])) for epoch, loss in enumerate(losses)]
    return [(TRAINING, now_ns, training), *epochs]


def _mean_of_known(errors: Array) -> float:
    """Mean of the errors that are not NaN; NaN if there are none."""
    known = errors[~np.isnan(errors)]
    return float(known.mean()) if known.size else float("nan")


def link_record(
    link: LinkStatistics,
    poses: tuple[int, int],
    samples: tuple[int, int],
    flying_version: int,
    unused: Mapping[str, int],
    now_ns: int,
) -> Logged:
    """The LINK record. `poses`: relayed and rejected; `samples`: received and labelled."""
    counts = (link.received, link.lost, link.duplicate, link.rejected.total(), link.sent)
    reasons = (unused[reason] for reason in UNUSED)
    return LINK, now_ns, np.array([*counts, *poses, *samples, flying_version, *reasons], dtype=np.float64)
