"""The spectral bound on the inner layers during training: norm(W_i)_2 <= bound."""

from typing import Final

import torch

from offboard.training.gradient import FLOAT
from offboard.training.network import below_bound

POWER_ITERATIONS: Final = 2


class SpectralBound:
    """Scales each inner layer down so that its largest singular value sigma_1 is below the bound.

    `approximate` estimates sigma_1 by power iteration, which starts from the vector of the call before, since weights
    change little between two calls. All layers are in one stack of zero-padded matrices. `exact` uses the singular
    values; it ends a round, so that no network leaves the round above the bound.
    """

    def __init__(self, weights: list[torch.Tensor], bound: float) -> None:
        self._weights = weights
        self._bound = bound
        channels, side = weights[0].shape[0], max(max(W.shape[1:]) for W in weights)
        self._padded = torch.zeros(len(weights), channels, side, side, dtype=FLOAT)
        self._v = torch.ones(len(weights) * channels, side, 1, dtype=FLOAT)

    def approximate(self) -> None:
        """W <- W bound / max(sigma_1, bound), with sigma_1 by power iteration."""
        for padded, W in zip(self._padded, self._weights, strict=True):
            padded[:, : W.shape[1], : W.shape[2]] = W
        shrink = self._bound / self._sigma_1().clamp_min(self._bound)
        for W, factor in zip(self._weights, shrink, strict=True):
            W.mul_(factor)

    def _sigma_1(self) -> torch.Tensor:
        """Estimate of the largest singular value of each padded matrix, [layers, C, 1, 1]; updates v."""
        W = self._padded.flatten(0, 1)
        for _ in range(POWER_ITERATIONS):
            # u = W v, v <- W' u / norm(W' u), sigma_1 = norm(W' u) / norm(u)
            u = torch.bmm(W, self._v)
            v = torch.bmm(W.mT, u)
            length = torch.linalg.vector_norm(v, dim=1, keepdim=True)
            self._v = v / length.clamp_min(1e-24)
        sigma_1 = length / torch.linalg.vector_norm(u, dim=1, keepdim=True).clamp_min(1e-12)
        return sigma_1.view(*self._padded.shape[:2], 1, 1)

    def exact(self) -> None:
        """W <- W min(1, bound / sigma_1), with sigma_1 by singular value decomposition."""
        for W in self._weights:
            W.copy_(torch.from_numpy(below_bound(W.numpy(), self._bound)))
