"""Ridge regression of last layers on given features, for a stack of networks at once.

Each entry of the stack has a Gram matrix of its own, so that a last layer for a part of the samples is one more entry
with weights that are zero elsewhere.
"""

from collections.abc import Sequence
from typing import Final

import torch

CONSTANT_SHARE: Final = 1e-6
"""Share of the ridge that acts on the constant feature: almost none."""


def ridge_fits(
    Phi: torch.Tensor,
    y: torch.Tensor,
    w: torch.Tensor,
    ridges: Sequence[float],
    slope: torch.Tensor | None = None,
    toward: torch.Tensor | None = None,
) -> torch.Tensor:
    """theta of each ridge, [ridges, C, k, 3], float32.

    theta = argmin sum_i w_i norm(y_i - theta' Phi_i)^2 + ridge theta' D theta
          = (Phi w Phi' + ridge D)^-1 Phi w y',  D = I, but nearly 0 for the constant feature, + slope

    With `toward`, the ridge pulls theta to it instead of to zero.

    The Gram matrix is summed in float32: its rounding, 1e-7 of its trace, is far below any ridge.

    Parameters
    ----------
    Phi: features with the constant as the last one, [C, k, n].
    y: labels, [C, 3, n]; finite everywhere.
    w: weights, [C, 1, n]; zero for samples without a label.
    slope: [C, k, k], double precision (offboard.training.slope_prior).
    toward: [C, k, 3]; None: zero.
    """
    weighted = Phi * w
    gram, moment = (weighted @ Phi.mT).double(), (weighted @ y.mT).double()
    D = torch.ones(Phi.shape[1], dtype=torch.float64)
    D[-1] = CONSTANT_SHARE
    strengths = torch.tensor(ridges, dtype=torch.float64)[:, None, None, None]
    penalty = torch.diag(D) if slope is None else torch.diag(D) + slope
    if toward is not None:
        moment = moment - gram @ toward.double()
    fits: torch.Tensor = torch.linalg.solve(gram + strengths * penalty, moment.expand(len(ridges), *moment.shape))
    return (fits if toward is None else fits + toward).float()


def scatter(errors: torch.Tensor, known: torch.Tensor) -> torch.Tensor:
    """Squared errors about their mean, [..., C]: the law on board removes a constant error.

    Parameters
    ----------
    errors: [..., C, 3, n].
    known: 1 for samples with a label, else 0, [C, 1, n].
    """
    count = known.sum(dim=-1, keepdim=True).clamp_min(1.0)
    about_mean = (errors - (errors * known).sum(dim=-1, keepdim=True) / count) * known
    return about_mean.square().sum(dim=(-2, -1))
