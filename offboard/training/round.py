"""One round of training: a pure function of samples, weights and a seed.

A round is `batches` mini-batches, each drawn partly from the newest samples and partly from the buffer, followed by a
ridge regression of the last layer over the same mixture. Training uses standardised labels y = Delta / label_scale; a
TrainerState holds theta in the units of u. A sample may lack the label of a channel; it then does not count for it.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import torch

from offboard.data.buffer import TEST, TRAINING, VALIDATION, SampleTable
from offboard.training.evidence import evidence_of, held_out
from offboard.training.gradient import FLOAT, LossGradient, Optimiser, Views, layer_outputs, parameters_of, predictions
from offboard.training.job import TrainerState, TrainingJob, TrainingResult
from offboard.training.network import (
    InputPlan,
    NetworkState,
    feature_set,
    phi,
    scales_from_data,
)
from offboard.training.refit import ridge_fits, scatter
from offboard.training.slope_prior import slope_gram
from offboard.training.spectral_bound import SpectralBound
from protocol.conventions import Array
from protocol.feature_codec import decode_feature_set, encode_for_wire
from protocol.feature_set import FeatureSet
from protocol.signals import CHANNELS

HELD_OUT_MINIMUM: Final = 20
"""With fewer held-out samples the first ridge of the configuration is used."""


def train(job: TrainingJob) -> TrainingResult:
    """Run one round. The same job gives the same result, bit for bit, on the same machine."""
    with torch.inference_mode():  # no autograd: the gradient is computed in offboard.training.gradient
        return _Round(job).run()


@dataclass(frozen=True, slots=True, eq=False)
class _Samples:
    """Samples as tensors, for the C channels that are trained."""

    z: torch.Tensor
    """Scaled inputs, [C, m, n]."""
    y: torch.Tensor
    """Labels, [C, 3, n]; zero where there is none."""
    known: torch.Tensor
    """1 where the sample has a label of the channel, else 0, [C, 1, n]."""

    def mean_square(self, errors: torch.Tensor) -> torch.Tensor:
        """Mean over the samples with a label, [C, 3, 1], of squared errors [C, 3, n]; NaN where there is none."""
        return (errors.square() * self.known).sum(dim=2, keepdim=True) / self.known.sum(dim=2, keepdim=True)

    def part(self, rows: slice) -> "_Samples":
        """Some of the samples."""
        return _Samples(self.z[:, :, rows], self.y[:, :, rows], self.known[:, :, rows])


class _Round:
    """The tensors of one round."""

    def __init__(self, job: TrainingJob) -> None:
        self._job = job
        self._plan = InputPlan.of(job.network_config)
        self._generator = torch.Generator().manual_seed((job.seed * 1_000_003 + job.state.rounds) % 2**63)
        newest, buffer = _of_split(job.newest, TRAINING), _of_split(job.buffer, TRAINING)
        self._network = self._scaled_to(newest.joined(buffer))
        self._draw = _draw_probability(job, newest, buffer)
        self._training = self._samples(newest.joined(buffer))
        self._label_scale = self._scale_of_labels()
        self._training.y.div_(self._label_scale)
        self._validation = held_out(job, VALIDATION)
        self._held_out = self._samples(self._validation.joined(held_out(job, TEST)))
        self._held_out.y.div_(self._label_scale)
        self._parameters = parameters_of(self._network)
        self._parameters.last_layer.div_(self._label_scale.mT)
        self._parameters.last_bias.div_(self._label_scale.mT)
        self._gradient = Views.of(torch.zeros_like(self._parameters.flat), self._network)
        self._loss_gradient = LossGradient(self._parameters, self._gradient, job.config.batch_size)
        self._optimiser = Optimiser(job.config, self._parameters.flat.numel(), job.state.moments, job.state.steps)
        self._spectral = SpectralBound(self._parameters.weights, job.network_config.spectral_norm_max)

    def run(self) -> TrainingResult:
        job = self._job
        losses = np.array([self._epoch(indices) for indices in self._batches()])
        if not bool(torch.isfinite(self._parameters.flat).all()):
            return self._diverged(losses)
        self._spectral.exact()
        if job.config.refit_last_layer:
            self._refit()
            losses[-1, 1:] = self._held_out_losses()
        state = TrainerState(self._network_now(), self._optimiser.moments, self._optimiser.steps, job.state.rounds + 1)
        parent = 0 if job.flying is None else job.flying.version
        trained = feature_set(state.network, self._plan, job.version, parent, job.samples_seen)
        candidate = decode_feature_set(encode_for_wire(trained, job.wire_dtype))
        evidence = evidence_of(job, candidate, self._numpy_difference(trained))
        return TrainingResult(state, candidate, evidence, losses, self._rows)

    def _diverged(self, losses: Array) -> TrainingResult:
        """The parameters are not finite: restore those from before the round, drop the momentum and send nothing."""
        state = TrainerState(self._job.state.network, (), 0, self._job.state.rounds + 1)
        candidate = feature_set(state.network, self._plan, self._job.version, 0, self._job.samples_seen)
        self._parameters = parameters_of(state.network)
        evidence = evidence_of(self._job, candidate, self._numpy_difference(candidate))
        evidence = replace(evidence, candidate_errors=np.full_like(evidence.candidate_errors, np.nan))
        return TrainingResult(state, candidate, evidence, losses, self._rows)

    @property
    def _rows(self) -> int:
        """Samples to train on."""
        return int(self._draw.shape[0])

    def _scaled_to(self, table: SampleTable) -> NetworkState:
        """The network, in the first round with scales from the data if so configured."""
        job = self._job
        if job.state.rounds or job.network_config.scaling != "data":
            return job.state.network
        offset, scale = scales_from_data(job.network_config, table.signals)
        return replace(job.state.network, offset=offset, scale=scale)

    def _samples(self, table: SampleTable) -> _Samples:
        z = self._plan.gather(table.signals, self._network.offset, self._network.scale)
        labels = np.ascontiguousarray(table.labels[:, list(self._plan.channels)].transpose(1, 2, 0))
        known = ~np.isnan(labels[:, :1])
        y = torch.from_numpy(np.where(known, labels, np.float32(0.0)))
        return _Samples(torch.from_numpy(z), y, torch.from_numpy(known.astype(np.float32)))

    def _scale_of_labels(self) -> torch.Tensor:
        """Root mean square of the labels of each channel and axis, at least the floor, [C, 3, 1]."""
        floors = (self._job.config.position_label_floor_m_s2, self._job.config.attitude_label_floor_rad_s2)
        floor = torch.tensor([floors[at] for at in self._plan.channels], dtype=FLOAT)[:, None, None]
        return self._training.mean_square(self._training.y).sqrt().nan_to_num(0.0).maximum(floor)

    def _batches(self) -> Iterator[torch.Tensor]:
        """Row numbers of the mini-batches of each epoch, [batches per epoch, M]."""
        config = self._job.config
        drawn = torch.rand(config.batches * config.batch_size, generator=self._generator, dtype=torch.float64)
        rows = torch.searchsorted(self._draw.cumsum(0), drawn).clamp_max(self._rows - 1)
        rows = rows.view(config.batches, config.batch_size)
        for part in np.array_split(np.arange(config.batches), config.epochs):
            yield rows[torch.from_numpy(part)]

    def _epoch(self, indices: torch.Tensor) -> Array:
        """Train on these mini-batches; returns training, validation and test loss, [3, 2]."""
        squares = torch.zeros(len(self._plan.channels), 3, indices.shape[1], dtype=FLOAT)
        every, table = self._job.config.projection_every, self._training
        complete = bool(table.known.all())
        known = [None] * len(indices) if complete else _batches_of(table.known, indices)
        mini_batches = zip(_batches_of(table.z, indices), _batches_of(table.y, indices), known, strict=True)
        for number, (z, y, has_label) in enumerate(mini_batches):
            errors = self._loss_gradient.at(z, y, has_label, self._dropout(z.shape[2]))
            self._optimiser.step(self._parameters.flat, self._gradient.flat)
            squares.addcmul_(errors, errors)
            if number % every == every - 1:
                self._spectral.approximate()
        drawn = table.known[:, :, indices.view(-1)].sum(dim=2, keepdim=True)
        trained = self._to_channels(squares.sum(dim=2, keepdim=True) / drawn)
        return np.vstack([trained, self._held_out_losses()])

    def _dropout(self, rows: int) -> torch.Tensor | None:
        share = self._job.network_config.dropout
        if share == 0.0:
            return None
        shape = (len(self._plan.channels), self._job.network_config.count - 1, rows)
        return (torch.rand(shape, generator=self._generator, dtype=FLOAT) >= share).to(FLOAT) / (1.0 - share)

    def _held_out_losses(self) -> Array:
        """Validation and test loss per channel, [2, 2]; NaN where there is no sample."""
        held_out, validation = self._held_out, self._validation.rows
        errors = predictions(held_out.z, self._parameters) - held_out.y
        parts = (slice(0, validation), slice(validation, None))
        return np.array([self._to_channels(held_out.part(part).mean_square(errors[:, :, part])) for part in parts])

    def _to_channels(self, squared: torch.Tensor) -> Array:
        """Squared errors [C, 3, 1] of standardised labels, in the units of u, summed over the axes: [2]."""
        losses = np.full(len(CHANNELS), np.nan)
        losses[list(self._plan.channels)] = (squared * self._label_scale.square()).sum(dim=(1, 2)).double().numpy()
        return losses

    def _refit(self) -> None:
        """Ridge regression of the last layer, weighted by how likely a mini-batch is to draw a sample.

        For each channel the ridge with the least scatter on the held-out samples is used. A channel without any label
        keeps its last layer.
        """
        table, held_out = self._training, self._held_out.part(slice(0, self._validation.rows))
        w, config = self._draw.to(FLOAT) * table.known, self._job.config
        fits = ridge_fits(self._phi(table.z), table.y, w, config.ridges, self._slope())
        scatters = scatter(held_out.y - fits.mT @ self._phi(held_out.z), held_out.known)
        enough = held_out.known.sum(dim=(1, 2)) >= HELD_OUT_MINIMUM
        best = torch.where(enough, scatters.argmin(dim=0), 0).tolist()
        for row in np.flatnonzero(table.known.sum(dim=(1, 2)).numpy()):
            theta = fits[best[row], row]
            self._parameters.last_layer[row] = theta[:-1]
            self._parameters.last_bias[row] = theta[-1:]

    def _slope(self) -> torch.Tensor | None:
        """What the regression adds to the ridge against steep maps, [C, k, k]; None for nothing."""
        weight = self._job.config.slope_weight
        if weight == 0.0:
            return None
        used = tuple(map(len, self._plan.names))
        return weight * slope_gram(self._parameters, used, self._generator)

    def _phi(self, z: torch.Tensor) -> torch.Tensor:
        """Phi with its constant, [C, k, n]."""
        features = layer_outputs(z, self._parameters)[-1]
        return torch.cat([features, torch.ones_like(features[:, :1])], dim=1)

    def _network_now(self) -> NetworkState:
        trained, start = self._parameters, self._network
        weights, biases = (tuple(one.numpy().copy() for one in part) for part in (trained.weights, trained.biases))
        theta, theta_0 = (part * self._label_scale.mT for part in (trained.last_layer, trained.last_bias))
        return NetworkState(start.offset, start.scale, weights, biases, theta.numpy(), theta_0.numpy())

    def _numpy_difference(self, trained: FeatureSet) -> float:
        """Largest difference of a feature between torch's float32 and numpy's float64 forward pass."""
        rows = self._validation.rows
        if not rows:
            return 0.0
        by_torch = layer_outputs(self._held_out.z[:, :, :rows], self._parameters)[-1].numpy()
        differences = [
            np.abs(phi(channel, self._validation.signals)[:, :-1] - by_torch[row].T).max()
            for row, channel in enumerate(trained.channels)
        ]
        return float(max(differences))


def _batches_of(table: torch.Tensor, rows: torch.Tensor) -> tuple[torch.Tensor, ...]:
    """Mini-batches [C, width, M] of the samples of a table [C, width, n] with these row numbers [batches, M]."""
    taken = table.gather(2, rows.view(-1).expand(*table.shape[:2], -1))
    return tuple(taken.unflatten(2, rows.shape).unbind(2))


def _draw_probability(job: TrainingJob, newest: SampleTable, buffer: SampleTable) -> torch.Tensor:
    """Probability with which a mini-batch draws each row, [n]: the newest (later ones more often), then the buffer."""
    config = job.buffer_config
    share = config.newest_fraction if newest.rows and buffer.rows else float(newest.rows > 0)
    fading = np.exp(-np.arange(newest.rows)[::-1] / config.newest_scale)
    of_newest = share * fading / max(float(fading.sum()), 1e-12)
    of_buffer = np.full(buffer.rows, (1.0 - share) / max(buffer.rows, 1))
    return torch.from_numpy(np.concatenate([of_newest, of_buffer]))


def _of_split(table: SampleTable, split: int) -> SampleTable:
    return table.take(table.split == split)
