"""A prior on the slope of the map: what the samples do not say about theta'Phi shall be flat.

The regression of the last layer pulls theta to zero. That leaves the slope open in directions that the flight did not
excite: features that are correlated on the path differ off it. This prior adds to the ridge the mean squared slope over
the unit box of scaled inputs,

    theta' G theta,    G = mean of J J' over the box,    J = dPhi/dz [k, m],

so that of all maps that fit the samples alike the flattest over the box is taken. On board, the slope is checked again
where the vehicle flies (onboard/control/slope.py): a map over the state is feedback.
"""

from typing import Final

import torch

from offboard.training.gradient import FLOAT, Views, layer_outputs

BOX_POINTS: Final = 128


def slope_gram(parameters: Views, inputs: tuple[int, ...], generator: torch.Generator) -> torch.Tensor:
    """G [C, k, k], in double precision; zero in the row and column of the constant.

    Parameters
    ----------
    inputs: of each channel, how many of the padded inputs are used.
    generator: draws the points in the box.
    """
    C, m = parameters.weights[0].shape[:2]
    z = 2.0 * torch.rand(C, m, BOX_POINTS, generator=generator, dtype=FLOAT) - 1.0
    for row, used in enumerate(inputs):
        z[row, used:] = 0.0
    outputs = layer_outputs(z, parameters)
    J = torch.eye(m, dtype=FLOAT).expand(C, BOX_POINTS, m, m)
    for W, h in zip(parameters.weights, outputs[1:], strict=True):
        J = (1.0 - h.mT.square()).unsqueeze(3) * (W.mT.unsqueeze(1) @ J)
    for row, used in enumerate(inputs):
        J[row, :, :, used:] = 0.0
    G = torch.einsum("cnim,cnjm->cij", J.double(), J.double()) / BOX_POINTS
    return torch.nn.functional.pad(G, (0, 1, 0, 1))
