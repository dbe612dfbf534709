"""Learns the inner layers that all conditions share, by the evidence of the conditions' samples.

In condition c the labels of an axis are y = Phi w + v with w ~ N(0, s I) and v ~ N(0, r I). The last layer is
integrated out, so that none has to be trained. For n samples drawn from the condition

    -2 log p(y | Phi, s, r) = y'y / r - |L^-1 Phi'y / r|^2 + n log r + k log s + 2 log|L|,   L L' = Phi'Phi / r + I / s.

Its mean over conditions, axes and samples is the loss of the inner layers and of r: type-II maximum likelihood, the
sum of ALPaCA's predictive likelihoods over a whole flight (Harrison, Sharma and Pavone 2018). Such features suit a
last layer that is estimated from few samples: they describe every condition with weights of about sqrt(s). s is fixed.
Labels are in units of their RMS over all conditions.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
import torch

from offboard.memory.config import MemoryConfig
from offboard.memory.memory import Condition, Memory, Prior, UnusableMemoryError, joined_conditions, with_theta
from offboard.training.network import InputPlan, NetworkState, below_bound, initial_state
from protocol.feature_config import TrainedFeatures

NOISE_START: Final = 0.1
"""r at the start, of the labels' power."""
PROJECTION_EVERY: Final = 10
LAST_RATE: Final = 0.05
"""Learning rate at the end, share of that at the start."""


def learn(
    features: TrainedFeatures,
    conditions: Sequence[Condition],
    spreads: tuple[float, float],
    config: MemoryConfig,
    start: Memory | None = None,
) -> Memory:
    """The memory that these conditions teach.

    Parameters
    ----------
    spreads: roots of S0 of the position [m/s^2] and of the attitude channel [rad/s^2], as the law on board has them.
    start: a memory whose inner layers are the start; None: random ones.

    Raises
    ------
    UnusableMemoryError
        If there is no sample, or too many conditions.
    """
    conditions = joined_conditions([[one for one in conditions if one.samples.rows]])
    if not conditions:
        raise UnusableMemoryError("no samples to learn from")
    rng = np.random.default_rng([config.seed, 1])
    network = initial_state(features, rng) if start is None else start.prior.network
    learner = _Learner(features, network, conditions, spreads, config)
    for step in range(config.steps):
        learner.step(step, rng)
    prior = with_theta(learner.prior(), features, conditions)
    return Memory(features, prior, conditions, len(conditions))


class _Learner:
    """Inner layers and noise under training."""

    def __init__(
        self,
        features: TrainedFeatures,
        network: NetworkState,
        conditions: Sequence[Condition],
        spreads: tuple[float, float],
        config: MemoryConfig,
    ) -> None:
        torch.set_num_threads(1)
        self._features, self._network, self._config = features, network, config
        plan = InputPlan.of(features)
        labels = [one.samples.labels[:, list(plan.channels)].transpose(1, 0, 2) for one in conditions]
        self._scale = np.array([_rms([one[row] for one in labels]) for row in range(len(plan.channels))])
        of_channels = np.array(spreads)[list(plan.channels)]
        self._variance = of_channels**2
        self._relative = torch.from_numpy((of_channels / self._scale) ** 2).float()[:, None, None, None]
        """s of each channel."""
        self._data = [
            (
                torch.from_numpy(plan.gather(one.samples.signals, network.offset, network.scale)).mT.contiguous(),
                torch.from_numpy((label / self._scale[:, None, None]).astype(np.float32)),
            )
            for one, label in zip(conditions, labels, strict=True)
        ]
        self._weights = [torch.tensor(W, requires_grad=True) for W in network.weights]
        self._biases = [torch.tensor(b, requires_grad=True) for b in network.biases]
        self._log_noise = torch.full((len(plan.channels),), float(np.log(NOISE_START)), requires_grad=True)
        parameters = [*self._weights, *self._biases, self._log_noise]
        self._optimiser = torch.optim.Adam(parameters, lr=config.learning_rate)

    def step(self, number: int, rng: np.random.Generator) -> None:
        """One step on samples of some conditions."""
        progress = number / max(self._config.steps, 1)
        rate = LAST_RATE + (1.0 - LAST_RATE) * 0.5 * (1.0 + np.cos(np.pi * progress))
        self._optimiser.param_groups[0]["lr"] = self._config.learning_rate * rate
        z, y = self._drawn(rng)
        loss = self._loss(z, y) + self._config.weight_decay * sum(W.square().sum() for W in self._weights)
        self._optimiser.zero_grad()
        loss.backward()
        self._optimiser.step()
        if number % PROJECTION_EVERY == PROJECTION_EVERY - 1 or number == self._config.steps - 1:
            self._project()

    def _drawn(self, rng: np.random.Generator) -> tuple[torch.Tensor, torch.Tensor]:
        """Inputs [C, E, n, m] and labels [C, E, n, 3] of n samples of each of E conditions."""
        inputs, labels = [], []
        for _ in range(self._config.conditions_per_step):
            z, y = self._data[rng.integers(len(self._data))]
            rows = torch.from_numpy(rng.integers(z.shape[1], size=self._config.samples_per_condition))
            inputs.append(z[:, rows])
            labels.append(y[:, rows])
        return torch.stack(inputs, 1), torch.stack(labels, 1)

    def _phi(self, z: torch.Tensor) -> torch.Tensor:
        """Phi with its constant, [C, E, n, k]."""
        h = z
        for W, b in zip(self._weights, self._biases, strict=True):
            h = torch.tanh(h @ W[:, None] + b[:, None])
        return torch.cat([h, torch.ones_like(h[..., :1])], dim=-1)

    def _loss(self, z: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        """-2 log p of the labels, mean over conditions and samples, summed over channels and axes."""
        Phi, n, s = self._phi(z), z.shape[2], self._relative
        r = self._log_noise.exp()[:, None, None, None]
        k = Phi.shape[-1]
        L = torch.linalg.cholesky(Phi.mT @ Phi / r + torch.eye(k) / s)
        projected = torch.linalg.solve_triangular(L, Phi.mT @ y / r, upper=False)
        misfit = y.square().sum((-1, -2)) / r[..., 0, 0] - projected.square().sum((-1, -2))
        volume = n * self._log_noise[:, None] + 2.0 * L.diagonal(dim1=-2, dim2=-1).log().sum(-1)  # k log s is constant
        return (misfit + y.shape[-1] * volume).mean(dim=1).sum() / n

    def _project(self) -> None:
        with torch.no_grad():
            for W in self._weights:
                W.copy_(torch.from_numpy(below_bound(W.numpy(), self._features.spectral_norm_max)))

    def prior(self) -> Prior:
        """The inner layers with theta = 0, and S0 and R in the units of u."""
        weights, biases = (tuple(one.detach().numpy().copy() for one in part) for part in (self._weights, self._biases))
        start = self._network
        blank = replace(start, last_layer=np.zeros_like(start.last_layer), last_bias=np.zeros_like(start.last_bias))
        network = replace(blank, weights=weights, biases=biases)
        noise = self._log_noise.detach().exp().double().numpy() * self._scale**2
        return Prior(network, self._variance, noise)


def _rms(labels: Sequence[np.ndarray]) -> float:
    """Root of the mean squared label of a channel's axes, each condition weighing the same."""
    power = np.mean([np.square(one, dtype=np.float64).mean() for one in labels])
    return float(np.sqrt(max(power, 1e-12)))
