"""One round of training: a pure function of samples, weights and a seed.

A round is `batches` mini-batches, each drawn partly from the newest samples and partly from the buffer, followed by a
ridge regression of the last layer over the same mixture. A sample may lack the label of a channel; it then does not
count for it. Several vehicles can be trained at once: they share the inner layers, and each has its own last layer, as
in OMAC (Shi et al. 2021); a mini-batch then has as many samples of each.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import reduce
from typing import Final

import numpy as np
import torch

from offboard.data.buffer import TRAINING, SampleTable
from offboard.training.gradient import FLOAT, LossGradient, Optimiser, Views, parameters_of
from offboard.training.job import RoundJob, TrainerState, TrainingJob, TrainingResult
from offboard.training.mixture import of_split
from offboard.training.network import InputPlan, NetworkState, scales_from_data
from offboard.training.slope_prior import slope_gram
from offboard.training.spectral_bound import SpectralBound
from offboard.training.vehicle_part import VehiclePart
from protocol.conventions import Array

ROWS_MINIMUM: Final = 8
"""Samples of a vehicle in a mini-batch, at least: with many vehicles a mini-batch is larger than configured."""


def train(job: TrainingJob) -> TrainingResult:
    """Run one round. The same job gives the same result, bit for bit, on the same machine."""
    results, state = train_together([job], job.state)
    return replace(results[0], state=state)


def train_together(jobs: Sequence[TrainingJob], state: TrainerState) -> tuple[list[TrainingResult], TrainerState]:
    """Run one round for V vehicles, whose settings are the same but for the seed.

    Parameters
    ----------
    jobs: one of each vehicle; their own states count for the number of their rounds only.
    state: the shared inner layers; row c V + v of its last layers, [C V, ...], is that of channel c and vehicle v.

    Returns
    -------
    The result of each vehicle, with its own last layer and without moments; and the shared state after the round.
    """
    with torch.inference_mode():  # no autograd: the gradient is computed in offboard.training.gradient
        return _of_vehicles(jobs, _Round(jobs, state))


def train_networks(job: RoundJob) -> tuple[TrainerState, Array]:
    """Run one round on samples of any origin, without gate or version; bit for bit like `train`.

    Returns
    -------
    The state after the round, and the training, validation and test loss per channel after each epoch
    [epochs, 3, channels]. If the parameters are not finite, the state is that from before the round, without moments.
    """
    with torch.inference_mode():
        one = _Round([job], job.state)
        losses, finite = one.train()
        return one.state_after() if finite else one.state_undone(), losses[0]


def _of_vehicles(jobs: Sequence[TrainingJob], one: "_Round") -> tuple[list[TrainingResult], TrainerState]:
    """Train, and return what `train_together` does."""
    losses, finite = one.train()
    if not finite:
        state = one.state_undone()
        before, results = parameters_of(state.network), list[TrainingResult]()
        for vehicle, (job, part, loss) in enumerate(zip(jobs, one.parts, losses, strict=True)):
            own = before.of_vehicle(vehicle)
            network = replace(state.network, last_layer=own.last_layer.numpy(), last_bias=own.last_bias.numpy())
            results.append(part.undone(job, TrainerState(network, (), 0, job.state.rounds + 1), own, loss))
        return results, state
    results = [
        part.result(job, TrainerState(part.network(), (), 0, job.state.rounds + 1), loss)
        for job, part, loss in zip(jobs, one.parts, losses, strict=True)
    ]
    return results, one.state_after()


class _Round:
    """The tensors of one round."""

    def __init__(self, jobs: Sequence[RoundJob], state: TrainerState) -> None:
        self._job, self._state = jobs[0], state
        self._plan = InputPlan.of(self._job.network_config)
        self._generator = torch.Generator().manual_seed((self._job.seed * 1_000_003 + state.rounds) % 2**63)
        self._network = self._scaled_to(jobs)
        self._parameters = parameters_of(self._network)
        own = [self._parameters.of_vehicle(vehicle) for vehicle in range(len(jobs))]
        self.parts = [VehiclePart(job, self._network, one) for job, one in zip(jobs, own, strict=True)]
        self._gradient = Views.of(torch.zeros_like(self._parameters.flat), self._network)
        config = self._job.config
        self._rows = config.batch_size if len(jobs) == 1 else max(ROWS_MINIMUM, config.batch_size // len(jobs))
        """Samples of each vehicle in a mini-batch."""
        self._loss_gradient = LossGradient(self._parameters, self._gradient, self._rows * len(jobs))
        self._optimiser = Optimiser(config, self._parameters.flat.numel(), state.moments, state.steps)
        self._spectral = SpectralBound(self._parameters.weights, self._job.network_config.spectral_norm_max)

    def train(self) -> tuple[list[Array], bool]:
        """Train; return the losses of each vehicle, [epochs, 3, 2], and whether all parameters are finite."""
        by_epoch = np.array([self._epoch(indices) for indices in self._batches()])
        losses = list(by_epoch.swapaxes(0, 1))
        if not bool(torch.isfinite(self._parameters.flat).all()):
            return losses, False
        self._spectral.exact()
        if self._job.config.refit_last_layer:
            self._refit()
            for part, loss in zip(self.parts, losses, strict=True):
                part.refitted(loss)
        return losses, True

    def state_after(self) -> TrainerState:
        """The state that the round leaves."""
        networks = [part.network() for part in self.parts]
        joined = with_last_layers(networks[0], networks)
        return TrainerState(joined, self._optimiser.moments, self._optimiser.steps, self._state.rounds + 1)

    def state_undone(self) -> TrainerState:
        """The state after a round that diverged: the parameters from before it, without momentum."""
        return TrainerState(self._state.network, (), 0, self._state.rounds + 1)

    def _scaled_to(self, jobs: Sequence[RoundJob]) -> NetworkState:
        """The network, in the first round with scales from the data if so configured."""
        network, config = self._state.network, self._job.network_config
        if self._state.rounds or config.scaling != "data":
            return network
        tables = [of_split(table, TRAINING) for job in jobs for table in (job.newest, job.buffer)]
        offset, scale = scales_from_data(config, reduce(SampleTable.joined, tables).signals)
        return replace(network, offset=offset, scale=scale)

    def _batches(self) -> Iterator[torch.Tensor]:
        """Row numbers of the mini-batches of each epoch, [V, batches per epoch, rows]."""
        config = self._job.config
        drawn = [part.drawn(config.batches, self._rows, self._generator) for part in self.parts]
        rows = torch.stack(drawn)
        for numbers in np.array_split(np.arange(config.batches), config.epochs):
            yield rows[:, torch.from_numpy(numbers)]

    def _epoch(self, indices: torch.Tensor) -> Array:
        """Train on these mini-batches; returns training, validation and test loss of each vehicle, [V, 3, 2]."""
        C, V = len(self._plan.channels), len(self.parts)
        squares = torch.zeros(C * V, self._plan.outputs, self._rows, dtype=FLOAT)
        every, tables = self._job.config.projection_every, [part.training for part in self.parts]
        complete = all(bool(table.known.all()) for table in tables)
        inputs = torch.stack([_drawn(table.z, rows) for table, rows in zip(tables, indices, strict=True)], 3)
        labels = _mini_batches([_drawn(table.y, rows) for table, rows in zip(tables, indices, strict=True)])
        known = [_drawn(table.known, rows) for table, rows in zip(tables, indices, strict=True)]
        masks = [None] * len(labels) if complete else _mini_batches(known)
        mini_batches = zip(inputs.flatten(3).unbind(2), labels, masks, strict=True)
        for number, (z, y, has_label) in enumerate(mini_batches):
            errors = self._loss_gradient.at(z, y, has_label, self._dropout(z.shape[2]))
            self._optimiser.step(self._parameters.flat, self._gradient.flat)
            squares.addcmul_(errors, errors)
            if number % every == every - 1:
                self._spectral.approximate()
        sums = squares.sum(dim=2, keepdim=True).unflatten(0, (C, V)).unbind(1)
        return np.array([part.losses(*own) for part, *own in zip(self.parts, sums, indices, strict=True)])

    def _dropout(self, rows: int) -> torch.Tensor | None:
        share = self._job.network_config.dropout
        if share == 0.0:
            return None
        shape = (len(self._plan.channels), self._job.network_config.count - 1, rows)
        return (torch.rand(shape, generator=self._generator, dtype=FLOAT) >= share).to(FLOAT) / (1.0 - share)

    def _refit(self) -> None:
        """Ridge regression of each vehicle's last layer, towards zero or towards the mean of the other vehicles.

        That mean is of the regressions towards zero, in the units of u. Which of the two a channel takes is decided by
        the vehicle's own held-out samples, as its ridge is: a jet of the others is taken where it is found here too.
        """
        slope, parts = self._slope(), self.parts
        regressions = [part.regression() for part in parts]
        alone = [part.fits(one, slope, [None]) for part, one in zip(parts, regressions, strict=True)]
        if len(parts) > 1:
            found = torch.stack([part.to_units(theta) for part, theta in zip(parts, alone, strict=True)])
            others = (found.sum(dim=0) - found) / (len(parts) - 1)
            means = [part.standardised(mean) for part, mean in zip(parts, others, strict=True)]
            every = zip(parts, regressions, means, strict=True)
            alone = [part.fits(one, slope, [None, mean]) for part, one, mean in every]
        for part, theta in zip(parts, alone, strict=True):
            part.use(theta)

    def _slope(self) -> torch.Tensor | None:
        """What the regression adds to the ridge against steep maps, [C, k, k]; None for nothing."""
        weight = self._job.config.slope_weight
        if weight == 0.0:
            return None
        used = tuple(map(len, self._plan.names))
        return weight * slope_gram(self._parameters, used, self._generator)


def with_last_layers(inner: NetworkState, networks: Sequence[NetworkState]) -> NetworkState:
    """The inner layers of `inner` with the last layers of V networks, in the order that `train_together` takes."""
    last_layer, last_bias = (
        np.stack([getattr(network, name) for network in networks], axis=1).reshape(-1, *shape)
        for name, shape in (("last_layer", inner.last_layer.shape[1:]), ("last_bias", inner.last_bias.shape[1:]))
    )
    return replace(inner, last_layer=last_layer, last_bias=last_bias)


def _drawn(table: torch.Tensor, rows: torch.Tensor) -> torch.Tensor:
    """The samples of a table [C, width, n] with these row numbers [batches, M]: [C, width, batches, M]."""
    return table.gather(2, rows.reshape(-1).expand(*table.shape[:2], -1)).unflatten(2, rows.shape)


def _mini_batches(drawn: Sequence[torch.Tensor]) -> tuple[torch.Tensor, ...]:
    """Mini-batches [C V, width, M] of V times [C, width, batches, M]."""
    batches: tuple[torch.Tensor, ...] = torch.stack(list(drawn), 1).flatten(0, 1).unbind(2)
    return batches
