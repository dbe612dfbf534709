"""The stack of networks as one flat vector of parameters, its gradient by hand, and the two optimisers on it.

A mini-batch through nets this small is all overhead for torch's autograd and optimisers. The same gradient is written
out here, into views of one flat vector; a test holds it against autograd. Samples lie along the last axis of inputs,
outputs and errors: products of such narrow matrices take half the time that way than with a row for each sample.
"""

from dataclasses import dataclass
from typing import Final

import torch

from offboard.config import TrainerConfig
from offboard.training.network import Array32, NetworkState

ADAM_FAST: Final = 0.9
ADAM_SLOW: Final = 0.999
ADAM_FLOOR: Final = 1e-8
_tanh_backward: Final = torch.ops.aten.tanh_backward.grad_input
"""By the overload with an output, which else is looked for at every call."""
MINUS_ONE: Final = torch.tensor(-1.0)


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """The parts of a flat vector, or of its gradient, in their shapes (NetworkState says which)."""

    flat: torch.Tensor
    weights: list[torch.Tensor]
    biases: list[torch.Tensor]
    last_layer: torch.Tensor
    last_bias: torch.Tensor

    @staticmethod
    def of(flat: torch.Tensor, network: NetworkState) -> "Views":
        """Views into `flat`, which is as long as the network has parameters."""
        arrays = _arrays(network)
        pieces = flat.split([array.size for array in arrays])
        parts = [piece.view(array.shape) for piece, array in zip(pieces, arrays, strict=True)]
        layers = len(network.weights)
        return Views(flat, parts[:layers], parts[layers:-2], parts[-2], parts[-1])


def _arrays(network: NetworkState) -> list[Array32]:
    return [*network.weights, *network.biases, network.last_layer, network.last_bias]


def parameters_of(network: NetworkState) -> Views:
    """A copy of the network's parameters, one flat vector with views."""
    flat = torch.cat([torch.from_numpy(array.reshape(-1)) for array in _arrays(network)])
    return Views.of(flat, network)


def layer_outputs(z: torch.Tensor, parameters: Views) -> list[torch.Tensor]:
    """Inputs z [C, m, n] and what each inner layer makes of it; the last is Phi without its constant."""
    outputs = [z]
    for W, b in zip(parameters.weights, parameters.biases, strict=True):
        outputs.append(_tanh_layer(outputs[-1], W.mT, b.mT))
    return outputs


def _tanh_layer(below: torch.Tensor, W: torch.Tensor, b: torch.Tensor, out: torch.Tensor | None = None) -> torch.Tensor:
    """tanh(W below + b), W [C, out, in].

    tanh(a) = 2 sigmoid(2 a) - 1, because torch's sigmoid is three times as fast as its tanh on a CPU.
    """
    sigmoid = torch.baddbmm(b, W, below, beta=2.0, alpha=2.0, out=out).sigmoid_()
    return torch.add(MINUS_ONE, sigmoid, alpha=2.0, out=sigmoid)


def predictions(z: torch.Tensor, parameters: Views) -> torch.Tensor:
    """The labels [C, 3, n] that inputs z [C, m, n] are thought to have."""
    return torch.baddbmm(parameters.last_bias.mT, parameters.last_layer.mT, layer_outputs(z, parameters)[-1])


@dataclass(frozen=True, slots=True, eq=False)
class _Layer:
    """A layer's part in a mini-batch of M, with every view and all room that it needs."""

    back: torch.Tensor
    """W', which takes delta to the layer below, [C, in, out]."""
    W: torch.Tensor
    """[C, out, in]"""
    b: torch.Tensor
    """[C, out, 1]"""
    gradient_back: torch.Tensor
    """Where the gradient by W' is written to."""
    gradient_b: torch.Tensor
    output: torch.Tensor
    """[C, out, M]"""
    delta: torch.Tensor
    """Derivative of L by the layer's sum W x + b, [C, out, M]."""
    delta_back: torch.Tensor
    """[C, M, out]"""

    @staticmethod
    def all_of(parameters: Views, gradient: Views, rows: int) -> list["_Layer"]:
        """The layers, the last one (theta) last."""
        weights, biases = [*parameters.weights, parameters.last_layer], [*parameters.biases, parameters.last_bias]
        of_weights, of_biases = [*gradient.weights, gradient.last_layer], [*gradient.biases, gradient.last_bias]
        layers = []
        for W, b, of_W, of_b in zip(weights, biases, of_weights, of_biases, strict=True):
            output, delta = torch.zeros(2, W.shape[0], W.shape[2], rows)
            layers.append(_Layer(W, W.mT, b.mT, of_W, of_b.mT, output, delta, delta.mT))
        return layers


class LossGradient:
    """Gradient of L = mean of squared errors over mini-batches of one size.

    Views and room are made once: anew for each mini-batch they would take a seventh of its time.

    Parameters
    ----------
    parameters: of the network; read at every mini-batch.
    gradient: where the gradient is written to.
    rows: M, samples of a mini-batch.
    """

    def __init__(self, parameters: Views, gradient: Views, rows: int) -> None:
        *self._inner, self._last = _Layer.all_of(parameters, gradient, rows)
        self._derivative = 2.0 / self._last.output.numel()

    def at(self, z: torch.Tensor, y: torch.Tensor, kept: torch.Tensor | None) -> torch.Tensor:
        """Write the gradient at a mini-batch; returns the errors, [C, 3, M], which the next one overwrites.

        Parameters
        ----------
        z: scaled inputs, [C, m, M].
        y: labels, [C, 3, M].
        kept: dropout's factors on the features, [C, k - 1, M]; None for no dropout.
        """
        last, inputs = self._last, [z]
        for layer in self._inner:
            inputs.append(_tanh_layer(inputs[-1], layer.W, layer.b, layer.output))
        features = inputs[-1] if kept is None else inputs[-1] * kept
        errors = torch.baddbmm(last.b, last.W, features, out=last.output).sub_(y)
        torch.mul(errors, self._derivative, out=last.delta)
        torch.bmm(features, last.delta_back, out=last.gradient_back)
        torch.sum(last.delta, 2, keepdim=True, out=last.gradient_b)
        above = last
        for layer, below in zip(reversed(self._inner), reversed(inputs[:-1]), strict=True):
            torch.bmm(above.back, above.delta, out=layer.delta)
            if above is last and kept is not None:
                layer.delta.mul_(kept)
            _tanh_backward(layer.delta, layer.output, grad_input=layer.delta)
            torch.bmm(below, layer.delta_back, out=layer.gradient_back)
            torch.sum(layer.delta, 2, keepdim=True, out=layer.gradient_b)
            above = layer
        return errors


class Optimiser:
    """Adam, or SGD with momentum, on one flat vector.

    Parameters
    ----------
    moments: those of an earlier round, to go on from; empty to begin.
    steps: steps behind those moments.
    """

    def __init__(self, config: TrainerConfig, size: int, moments: tuple[Array32, ...], steps: int) -> None:
        self._config = config
        count = 2 if config.optimiser == "adam" else 1
        fits = len(moments) == count and all(moment.size == size for moment in moments)
        start = [torch.from_numpy(moment.copy()) for moment in moments] if fits else []
        self._moments = start or [torch.zeros(size) for _ in range(count)]
        self.steps = steps if fits else 0
        self._step = torch.tensor(0.0)

    @property
    def moments(self) -> tuple[Array32, ...]:
        """To be handed to the next round."""
        return tuple(moment.numpy().copy() for moment in self._moments)

    def step(self, parameters: torch.Tensor, gradient: torch.Tensor) -> None:
        """One step, in place."""
        self.steps += 1
        if self._config.optimiser == "adam":
            self._adam(parameters, gradient)
        else:
            gradient.add_(parameters, alpha=self._config.weight_decay)
            momentum = self._moments[0].mul_(self._config.momentum).add_(gradient)
            parameters.add_(momentum, alpha=-self._config.learning_rate)

    def _adam(self, parameters: torch.Tensor, gradient: torch.Tensor) -> None:
        """Kingma and Ba 2015, by the kernel behind torch.optim.Adam(fused=True): the class takes 70 us, it takes 5."""
        self._step.fill_(self.steps)
        torch._fused_adam_(
            [parameters],
            [gradient],
            [self._moments[0]],
            [self._moments[1]],
            [],
            [self._step],
            lr=self._config.learning_rate,
            beta1=ADAM_FAST,
            beta2=ADAM_SLOW,
            weight_decay=self._config.weight_decay,
            eps=ADAM_FLOOR,
            amsgrad=False,
            maximize=False,
        )
