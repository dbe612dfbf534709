"""The prior on the slope: its matrix by differences, and what it does to a direction that was not excited."""

import numpy as np
import torch

from offboard.training.gradient import layer_outputs, parameters_of
from offboard.training.network import InputPlan, initial_state
from offboard.training.slope_prior import BOX_POINTS, slope_gram
from tests.offboard.training.test_network import CONFIG

PLAN = InputPlan.of(CONFIG)
USED = tuple(map(len, PLAN.names))
PARAMETERS = parameters_of(initial_state(CONFIG, np.random.default_rng(2)))


def test_the_matrix_is_the_mean_squared_slope_over_the_box() -> None:
    G = slope_gram(PARAMETERS, USED, torch.Generator().manual_seed(5))
    C, k = len(USED), CONFIG.count
    assert G.shape == (C, k, k)
    z = 2.0 * torch.rand(C, PLAN.width, BOX_POINTS, generator=torch.Generator().manual_seed(5)) - 1.0
    for row, used in enumerate(USED):
        z[row, used:] = 0.0
    step, expected = 1e-3, torch.zeros(C, k - 1, k - 1, dtype=torch.float64)
    for column in range(PLAN.width):
        moved = [z.clone(), z.clone()]
        for sign, one in zip((1.0, -1.0), moved, strict=True):
            for row, used in enumerate(USED):
                one[row, column] += sign * step * (column < used)
        ahead, behind = (layer_outputs(one, PARAMETERS)[-1].double() for one in moved)
        slope = (ahead - behind) / (2.0 * step)
        expected += slope @ slope.mT / BOX_POINTS
    assert torch.allclose(G[:, :-1, :-1], expected, rtol=0.01, atol=0.01 * float(expected.max()))
    assert float(G[:, -1].abs().max()) == float(G[:, :, -1].abs().max()) == 0.0


def test_a_direction_that_was_not_excited_becomes_flat() -> None:
    """Samples along one input: with the prior the map fits them as well, and hardly changes along the others."""
    generator = torch.Generator().manual_seed(1)
    z = torch.zeros(len(USED), PLAN.width, 200)
    z[:, 0] = torch.linspace(-1.0, 1.0, 200)
    y = torch.sin(2.0 * z[:, :1]).double()
    Phi = layer_outputs(z, PARAMETERS)[-1].double()
    Phi = torch.cat([Phi, torch.ones_like(Phi[:, :1])], dim=1)
    G, eye = slope_gram(PARAMETERS, USED, generator), torch.eye(CONFIG.count, dtype=torch.float64)
    misfit, slope = [], []
    for prior in (0.01 * eye, 0.01 * (eye + 30.0 * G)):
        theta = torch.linalg.solve(Phi @ Phi.mT + prior, Phi @ y.mT)
        misfit.append(float((theta.mT @ Phi - y).square().mean().sqrt()))
        moved = z.clone()
        moved[:, 1] += 0.5
        there = layer_outputs(moved, PARAMETERS)[-1].double()
        there = torch.cat([there, torch.ones_like(there[:, :1])], dim=1)
        slope.append(float((theta.mT @ (there - Phi)).square().mean().sqrt()) / 0.5)
    assert misfit[1] < misfit[0] + 0.05
    assert slope[1] < 0.7 * slope[0]
