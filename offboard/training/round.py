"""One round of training: a pure function of samples, weights and a seed.

A round is `batches` mini-batches, each drawn partly from the newest samples and partly from the buffer, followed by a
ridge regression of the last layer over the same mixture. Training uses standardised labels y = Delta / label_scale; a
TrainerState holds theta in the units of u.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np
import torch

from offboard.data.buffer import TEST, TRAINING, VALIDATION, SampleTable
from offboard.training.evidence import evidence_of, held_out
from offboard.training.gradient import LossGradient, Optimiser, Views, layer_outputs, parameters_of, predictions
from offboard.training.job import TrainerState, TrainingJob, TrainingResult
from offboard.training.network import InputPlan, NetworkState, feature_set, phi, scales_from_data
from offboard.training.slope_prior import slope_gram
from offboard.training.spectral_bound import SpectralBound
from protocol.conventions import Array
from protocol.feature_codec import decode_feature_set, encode_for_wire
from protocol.feature_set import FeatureSet
from protocol.signals import CHANNELS

HELD_OUT_MINIMUM: Final = 20
"""With fewer held-out samples the first ridge of the configuration is used."""

torch.set_num_threads(1)  # more threads make products this small slower; one thread sums in a fixed order


def train(job: TrainingJob) -> TrainingResult:
    """Run one round. The same job gives the same result, bit for bit, on the same machine."""
    with torch.inference_mode():  # no autograd: the gradient is computed in offboard.training.gradient
        return _Round(job).run()


class _Round:
    """The tensors of one round."""

    def __init__(self, job: TrainingJob) -> None:
        self._job = job
        self._plan = InputPlan.of(job.network_config)
        self._generator = torch.Generator().manual_seed((job.seed * 1_000_003 + job.state.rounds) % 2**63)
        network = job.state.network
        newest, buffer = _of_split(job.newest, TRAINING), _of_split(job.buffer, TRAINING)
        if job.state.rounds == 0 and job.network_config.scaling == "data":
            offset, scale = scales_from_data(job.network_config, newest.joined(buffer).signals)
            network = replace(network, offset=offset, scale=scale)
        self._network = network
        self._samples = newest.rows + buffer.rows
        self._draw = _draw_probability(job, newest, buffer)
        self._z, self._y_raw = self._inputs(newest.joined(buffer))
        self._label_scale = self._scale_of_labels()
        self._y = self._y_raw / self._label_scale
        self._held_out = [self._inputs(held_out(job, split)) for split in (VALIDATION, TEST)]
        self._parameters = parameters_of(network)
        self._parameters.last_layer.div_(self._label_scale.mT)
        self._parameters.last_bias.div_(self._label_scale.mT)
        self._gradient = Views.of(torch.zeros_like(self._parameters.flat), network)
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
        return TrainingResult(state, candidate, evidence, losses, self._samples)

    def _diverged(self, losses: Array) -> TrainingResult:
        """The parameters are not finite: restore those from before the round, drop the momentum and send nothing."""
        state = TrainerState(self._job.state.network, (), 0, self._job.state.rounds + 1)
        candidate = feature_set(state.network, self._plan, self._job.version, 0, self._job.samples_seen)
        self._parameters = parameters_of(state.network)
        evidence = evidence_of(self._job, candidate, self._numpy_difference(candidate))
        evidence = replace(evidence, candidate_errors=np.full_like(evidence.candidate_errors, np.nan))
        return TrainingResult(state, candidate, evidence, losses, self._samples)

    def _inputs(self, table: SampleTable) -> tuple[torch.Tensor, torch.Tensor]:
        """Scaled inputs z [C, m, n] and labels Delta [C, 3, n] of a table."""
        z = self._plan.gather(table.signals, self._network.offset, self._network.scale)
        labels = table.labels[:, list(self._plan.channels)].transpose(1, 2, 0)
        return torch.from_numpy(z), torch.from_numpy(np.ascontiguousarray(labels))

    def _scale_of_labels(self) -> torch.Tensor:
        """Root mean square of the labels of each channel and axis, at least the floor, [C, 3, 1]."""
        floors = (self._job.config.position_label_floor_m_s2, self._job.config.attitude_label_floor_rad_s2)
        floor = torch.tensor([floors[at] for at in self._plan.channels])[:, None, None]
        return torch.maximum(self._y_raw.square().mean(dim=2, keepdim=True).sqrt(), floor)

    def _batches(self) -> Iterator[torch.Tensor]:
        """Row numbers of the mini-batches of each epoch, [batches per epoch, M]."""
        config = self._job.config
        drawn = torch.rand(config.batches * config.batch_size, generator=self._generator, dtype=torch.float64)
        rows = torch.searchsorted(self._draw.cumsum(0), drawn).clamp_max(self._samples - 1)
        rows = rows.view(config.batches, config.batch_size)
        for part in np.array_split(np.arange(config.batches), config.epochs):
            yield rows[torch.from_numpy(part)]

    def _epoch(self, indices: torch.Tensor) -> Array:
        """Train on these mini-batches; returns training, validation and test loss, [3, 2]."""
        squares = torch.zeros(len(self._plan.channels), 3, indices.shape[1])
        every = self._job.config.projection_every
        inputs, labels = _batches_of(self._z, indices), _batches_of(self._y, indices)
        for number, (z, y) in enumerate(zip(inputs, labels, strict=True)):
            errors = self._loss_gradient.at(z, y, self._dropout(z.shape[2]))
            self._optimiser.step(self._parameters.flat, self._gradient.flat)
            squares.addcmul_(errors, errors)
            if number % every == every - 1:
                self._spectral.approximate()
        trained = self._to_channels(squares.mean(dim=2, keepdim=True) / max(len(indices), 1))
        return np.vstack([trained, self._held_out_losses()])

    def _dropout(self, rows: int) -> torch.Tensor | None:
        share = self._job.network_config.dropout
        if share == 0.0:
            return None
        shape = (len(self._plan.channels), self._job.network_config.count - 1, rows)
        return (torch.rand(shape, generator=self._generator) >= share) / (1.0 - share)

    def _held_out_losses(self) -> Array:
        """Validation and test loss per channel, [2, 2]; NaN where there is no sample."""
        rows = []
        for z, y in self._held_out:
            if z.shape[2] == 0:
                rows.append(np.full(len(CHANNELS), np.nan))
            else:
                errors = predictions(z, self._parameters) - y / self._label_scale
                rows.append(self._to_channels(errors.square().mean(dim=2, keepdim=True)))
        return np.array(rows)

    def _to_channels(self, squared: torch.Tensor) -> Array:
        """Squared errors [C, 3, 1] of standardised labels, in the units of u, summed over the axes: [2]."""
        losses = np.full(len(CHANNELS), np.nan)
        losses[list(self._plan.channels)] = (squared * self._label_scale.square()).sum(dim=(1, 2)).double().numpy()
        return losses

    def _refit(self) -> None:
        """Ridge regression of the last layer, w_i being the probability that a mini-batch draws sample i.

        theta = argmin sum_i w_i norm(y_i - theta' Phi_i)^2 + ridge theta' D theta
              = (Phi w Phi' + ridge D)^-1 Phi w y',  D = I, but nearly 0 for the constant feature, + slope_weight G

        For each channel the ridge with the least scatter on the held-out samples is used.
        """
        Phi, Phi_held_out = self._phi(self._z), self._phi(self._held_out[0][0])
        y_held_out = (self._held_out[0][1] / self._label_scale).double()
        Phi_w = Phi * self._draw
        gram, moment = Phi_w @ Phi.mT, Phi_w @ self._y.double().mT
        D = torch.eye(Phi.shape[1], dtype=torch.float64)
        D[-1, -1] = 1e-6
        if self._job.config.slope_weight > 0.0:
            used = tuple(map(len, self._plan.names))
            D = D + self._job.config.slope_weight * slope_gram(self._parameters, used, self._generator)
        fits = [torch.linalg.solve(gram + ridge * D, moment) for ridge in self._job.config.ridges]
        scatters = torch.stack([_scatter(y_held_out - theta.mT @ Phi_held_out) for theta in fits])
        enough = Phi_held_out.shape[2] >= HELD_OUT_MINIMUM
        best = scatters.argmin(dim=0).tolist() if enough else [0] * len(self._plan.channels)
        theta = torch.stack([fits[ridge][row] for row, ridge in enumerate(best)]).float()
        self._parameters.last_layer.copy_(theta[:, :-1])
        self._parameters.last_bias.copy_(theta[:, -1:])

    def _phi(self, z: torch.Tensor) -> torch.Tensor:
        """Phi with its constant, [C, k, n], in double precision."""
        features = layer_outputs(z, self._parameters)[-1].double()
        return torch.cat([features, torch.ones_like(features[:, :1])], dim=1)

    def _network_now(self) -> NetworkState:
        trained, start = self._parameters, self._network
        weights, biases = (tuple(one.numpy().copy() for one in part) for part in (trained.weights, trained.biases))
        theta, theta_0 = (part * self._label_scale.mT for part in (trained.last_layer, trained.last_bias))
        return NetworkState(start.offset, start.scale, weights, biases, theta.numpy(), theta_0.numpy())

    def _numpy_difference(self, trained: FeatureSet) -> float:
        """Largest difference of a feature between torch's float32 and numpy's float64 forward pass."""
        (z, _), table = self._held_out[0], held_out(self._job, VALIDATION)
        if not table.rows:
            return 0.0
        by_torch = layer_outputs(z, self._parameters)[-1].numpy()
        differences = [
            np.abs(phi(channel, table.signals)[:, :-1] - by_torch[row].T).max()
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


def _scatter(errors: torch.Tensor) -> torch.Tensor:
    """Squared errors about their mean, [C], of errors [C, 3, n]: the law on board removes a constant error."""
    return (errors - errors.mean(dim=2, keepdim=True)).square().sum(dim=(1, 2))


def _of_split(table: SampleTable, split: int) -> SampleTable:
    return table.take(table.split == split)
