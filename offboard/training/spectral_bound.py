"""The spectral bound on the inner layers, kept while they are trained."""

from typing import Final

import torch

from offboard.training.network import below_bound

POWER_ITERATIONS: Final = 2


class SpectralBound:
    """Keeps each inner layer's largest singular value below the bound while training.

    Between exact projections the norm is tracked by power iteration from the last vector (weights move little between
    two calls), all layers in one stack of zero-padded matrices. `exact` ends a round, so that what leaves the trainer
    is below the bound for sure.
    """

    def __init__(self, weights: list[torch.Tensor], bound: float) -> None:
        self._weights = weights
        self._bound = bound
        channels, side = weights[0].shape[0], max(max(W.shape[1:]) for W in weights)
        self._padded = torch.zeros(len(weights), channels, side, side)
        self._v = torch.ones(len(weights) * channels, side, 1)

    def approximate(self) -> None:
        """Shrink what exceeds the bound, by power iteration."""
        for padded, W in zip(self._padded, self._weights, strict=True):
            padded[:, : W.shape[1], : W.shape[2]] = W
        shrink = self._bound / self._norms().clamp_min(self._bound)
        for W, factor in zip(self._weights, shrink, strict=True):
            W.mul_(factor)

    def _norms(self) -> torch.Tensor:
        """Norms of the padded matrices, [layers, C, 1, 1], better than those before: so are the singular vectors v."""
        W = self._padded.flatten(0, 1)
        for _ in range(POWER_ITERATIONS):
            u = torch.bmm(W, self._v)
            v = torch.bmm(W.mT, u)
            length = torch.linalg.vector_norm(v, dim=1, keepdim=True)
            self._v = v / length.clamp_min(1e-24)
        norms = length / torch.linalg.vector_norm(u, dim=1, keepdim=True).clamp_min(1e-12)
        return norms.view(*self._padded.shape[:2], 1, 1)

    def exact(self) -> None:
        """Shrink what exceeds the bound, by singular values."""
        for W in self._weights:
            W.copy_(torch.from_numpy(below_bound(W.numpy(), self._bound)))
