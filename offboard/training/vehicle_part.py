"""One vehicle's part of a round: its samples as tensors, its last layer, and what the round returns for it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
import torch

from offboard.data.buffer import TEST, TRAINING, VALIDATION, SampleTable
from offboard.training.evidence import as_sent, evidence_of, held_out
from offboard.training.gradient import FLOAT, Views, layer_outputs, predictions
from offboard.training.job import RoundJob, TrainerState, TrainingJob, TrainingResult
from offboard.training.mixture import draw_probability, of_split
from offboard.training.network import InputPlan, NetworkState, feature_set, phi
from offboard.training.refit import ridge_fits, scatter
from protocol.conventions import Array
from protocol.feature_set import FeatureSet

HELD_OUT_MINIMUM: Final = 20
"""With fewer held-out samples the first ridge of the configuration is used."""


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Samples as tensors, for the C channels that are trained."""

    z: torch.Tensor
    """Scaled inputs, [C, m, n]."""
    y: torch.Tensor
    """Labels, [C, q, n]; zero where there is none."""
    known: torch.Tensor
    """1 where the sample has a label of the channel, else 0, [C, 1, n]."""

    def mean_square(self, errors: torch.Tensor) -> torch.Tensor:
        """Mean over the samples with a label, [C, 3, 1], of squared errors [C, 3, n]; NaN where there is none."""
        return (errors.square() * self.known).sum(dim=2, keepdim=True) / self.known.sum(dim=2, keepdim=True)

    def part(self, rows: slice) -> "Samples":
        """Some of the samples."""
        return Samples(self.z[:, :, rows], self.y[:, :, rows], self.known[:, :, rows])


class Regression(NamedTuple):
    """What the regressions of a last layer share: Phi with its constant and the weights of the samples."""

    Phi: torch.Tensor
    """[C, k, n]"""
    w: torch.Tensor
    """[C, 1, n]"""
    held_out: torch.Tensor
    """Phi of the held-out samples, [C, k, h]."""


class VehiclePart:
    """Samples, label scale and last layer of one vehicle.

    Training uses standardised labels y = Delta / label_scale; a NetworkState holds theta in the units of u.

    Parameters
    ----------
    network: its offset and scale are those of the inputs.
    own: the parameters under training, with this vehicle's last layers, in the units of u; they are standardised here.
    """

    def __init__(self, job: RoundJob, network: NetworkState, own: Views) -> None:
        self.job = job
        self._plan = InputPlan.of(job.network_config)
        self._network, self._own = network, own
        newest, buffer = of_split(job.newest, TRAINING), of_split(job.buffer, TRAINING)
        self._draw = torch.from_numpy(draw_probability(job.buffer_config, newest, buffer))
        self.training: Final = self._samples(newest.joined(buffer))
        self._label_scale = self._scale_of_labels()
        self.training.y.div_(self._label_scale)
        self._validation = held_out(job, VALIDATION)
        self._held_out = self._samples(self._validation.joined(held_out(job, TEST)))
        self._held_out.y.div_(self._label_scale)
        own.last_layer.div_(self._label_scale.mT)
        own.last_bias.div_(self._label_scale.mT)

    @property
    def rows(self) -> int:
        """Samples to train on."""
        return int(self._draw.shape[0])

    def _samples(self, table: SampleTable) -> Samples:
        z = self._plan.gather(table.signals, self._network.offset, self._network.scale)
        labels = np.ascontiguousarray(table.labels[:, list(self._plan.channels)].transpose(1, 2, 0))
        known = ~np.isnan(labels[:, :1])
        y = torch.from_numpy(np.where(known, labels, np.float32(0.0)))
        return Samples(torch.from_numpy(z), y, torch.from_numpy(known.astype(np.float32)))

    def _scale_of_labels(self) -> torch.Tensor:
        """Root mean square of the labels of each channel and axis, at least the floor, [C, 3, 1]."""
        floors = self.job.label_floors
        floor = torch.tensor([floors[at] for at in self._plan.channels], dtype=FLOAT)[:, None, None]
        return self.training.mean_square(self.training.y).sqrt().nan_to_num(0.0).maximum(floor)

    def drawn(self, batches: int, rows: int, generator: torch.Generator) -> torch.Tensor:
        """Row numbers of the mini-batches of a round, [batches, rows]."""
        drawn = torch.rand(batches * rows, generator=generator, dtype=torch.float64)
        found = torch.searchsorted(self._draw.cumsum(0), drawn).clamp_max(self.rows - 1)
        return found.view(batches, rows)

    def losses(self, squares: torch.Tensor, indices: torch.Tensor) -> Array:
        """Training, validation and test loss, [3, 2], after mini-batches with these row numbers.

        Parameters
        ----------
        squares: squared errors of these mini-batches, [C, 3, 1].
        """
        drawn = self.training.known[:, :, indices.reshape(-1)].sum(dim=2, keepdim=True)
        return np.vstack([self._to_channels(squares / drawn), self._held_out_losses()])

    def _held_out_losses(self) -> Array:
        """Validation and test loss per channel, [2, 2]; NaN where there is no sample."""
        held_out, validation = self._held_out, self._validation.rows
        errors = predictions(held_out.z, self._own) - held_out.y
        parts = (slice(0, validation), slice(validation, None))
        return np.array([self._to_channels(held_out.part(part).mean_square(errors[:, :, part])) for part in parts])

    def _to_channels(self, squared: torch.Tensor) -> Array:
        """Squared errors [C, 3, 1] of standardised labels, in the units of u, summed over the axes: [2]."""
        losses = np.full(len(self.job.network_config.all_channels), np.nan)
        losses[list(self._plan.channels)] = (squared * self._label_scale.square()).sum(dim=(1, 2)).double().numpy()
        return losses

    def regression(self) -> Regression:
        """The features as they are now; a sample weighs as much as a mini-batch is likely to draw it."""
        held_out = self._held_out.part(slice(0, self._validation.rows))
        w = self._draw.to(FLOAT) * self.training.known
        return Regression(self._phi(self.training.z), w, self._phi(held_out.z))

    def fits(
        self, regression: Regression, slope: torch.Tensor | None, toward: Sequence[torch.Tensor | None]
    ) -> torch.Tensor:
        """theta [C, k, 3] by ridge regression, in standardised labels.

        Of all ridges and all thetas in `toward` (None: zero) to which the ridge may pull, each channel takes the pair
        with the least scatter on the held-out samples; with too few of these the first pair.
        """
        held_out, ridges = self._held_out.part(slice(0, self._validation.rows)), self.job.config.ridges
        table, (Phi, w, ahead) = self.training, regression
        fits = torch.cat([ridge_fits(Phi, table.y, w, ridges, slope, theta) for theta in toward])
        scatters = scatter(held_out.y - fits.mT @ ahead, held_out.known)
        enough = held_out.known.sum(dim=(1, 2)) >= HELD_OUT_MINIMUM
        best = torch.where(enough, scatters.argmin(dim=0), 0).tolist()
        return torch.stack([fits[at, row] for row, at in enumerate(best)])

    def use(self, theta: torch.Tensor) -> None:
        """Fly theta [C, k, 3], in standardised labels. A channel without any label keeps its last layer."""
        for row in np.flatnonzero(self.training.known.sum(dim=(1, 2)).numpy()):
            self._own.last_layer[row] = theta[row, :-1]
            self._own.last_bias[row] = theta[row, -1:]

    def to_units(self, theta: torch.Tensor) -> torch.Tensor:
        """theta of standardised labels in the units of u."""
        return theta * self._label_scale.mT

    def standardised(self, theta: torch.Tensor) -> torch.Tensor:
        """theta in the units of u for standardised labels."""
        return theta / self._label_scale.mT

    def refitted(self, losses: Array) -> None:
        """Write the held-out losses of the refitted last layer to those of the last epoch, [epochs, 3, 2]."""
        losses[-1, 1:] = self._held_out_losses()

    def _phi(self, z: torch.Tensor) -> torch.Tensor:
        """Phi with its constant, [C, k, n]."""
        features = layer_outputs(z, self._own)[-1]
        return torch.cat([features, torch.ones_like(features[:, :1])], dim=1)

    def network(self) -> NetworkState:
        """The networks of this vehicle, as trained so far."""
        trained, start = self._own, self._network
        weights, biases = (tuple(one.numpy().copy() for one in part) for part in (trained.weights, trained.biases))
        theta, theta_0 = (part * self._label_scale.mT for part in (trained.last_layer, trained.last_bias))
        return NetworkState(start.offset, start.scale, weights, biases, theta.numpy(), theta_0.numpy())

    def result(self, job: TrainingJob, state: TrainerState, losses: Array) -> TrainingResult:
        """The result of a round that ended with this state. job: this vehicle's."""
        parent = 0 if job.flying is None else job.flying.version
        trained = feature_set(state.network, self._plan, job.version, parent, job.samples_seen)
        candidate = as_sent(job, trained)
        evidence = evidence_of(job, candidate, self._numpy_difference(trained))
        return TrainingResult(state, candidate, evidence, losses, self.rows)

    def undone(self, job: TrainingJob, state: TrainerState, own: Views, losses: Array) -> TrainingResult:
        """The result of a round that diverged: the state and the parameters from before it, and nothing to send."""
        self._own = own
        candidate = feature_set(state.network, self._plan, job.version, 0, job.samples_seen)
        evidence = evidence_of(job, candidate, self._numpy_difference(candidate))
        evidence = replace(evidence, candidate_errors=np.full_like(evidence.candidate_errors, np.nan))
        return TrainingResult(state, candidate, evidence, losses, self.rows)

    def _numpy_difference(self, trained: FeatureSet) -> float:
        """Largest difference of a feature between torch's float32 and numpy's float64 forward pass."""
        rows = self._validation.rows
        if not rows:
            return 0.0
        by_torch = layer_outputs(self._held_out.z[:, :, :rows], self._own)[-1].numpy()
        differences = [
            np.abs(phi(channel, self._validation.signals)[:, :-1] - by_torch[row].T).max()
            for row, channel in enumerate(trained.channels)
        ]
        return float(max(differences))
