"""The parameters of all networks as one flat vector, the gradient of the loss, and the optimisers.

Forward:     h_0 = z,  h_l = tanh(W_l h_(l-1) + b_l),  Phi = h_L,  y_hat = theta' Phi + theta_0
Loss:        L = mean((y_hat - y)^2) over channels, axes and samples; an error without a label counts as zero
Backward:    delta_y = dL/dy_hat = 2 (y_hat - y) / (3 C M)
             delta_l = dL/d(W_l h_(l-1) + b_l) = (W_(l+1)' delta_(l+1)) (1 - h_l^2), elementwise; theta' is W_(L+1)
Gradient:    dL/dW_l' = h_(l-1) delta_l',  dL/db_l = sum of delta_l over the samples; the same for theta and theta_0

C channels are trained at once, on mini-batches of M samples. V vehicles may share the inner layers, each with a last
layer of its own: a mini-batch then has M / V samples of each, one vehicle after the other.

The gradient is written out, into views of one flat vector, because torch's autograd and optimisers take most of the
time of a mini-batch with networks this small; a test compares it with autograd. Samples are along the last axis of
inputs, outputs and errors: products of such narrow matrices then take half the time.
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
"""delta (1 - h^2). The overload is named, because torch would look for it at every call."""
FLOAT: Final = torch.float32
"""Of all parameters, inputs and labels, whatever torch's default is."""


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """The parts of a flat vector of parameters, or of its gradient, in the shapes of NetworkState."""

    flat: torch.Tensor
    weights: list[torch.Tensor]
    biases: list[torch.Tensor]
    last_layer: torch.Tensor
    last_bias: torch.Tensor

    def of_vehicle(self, vehicle: int) -> "Views":
        """The same inner layers, with the last layers of one vehicle."""
        C = self.weights[0].shape[0]
        last_layer, last_bias = (one.unflatten(0, (C, -1))[:, vehicle] for one in (self.last_layer, self.last_bias))
        return Views(self.flat, self.weights, self.biases, last_layer, last_bias)

    @staticmethod
    def of(flat: torch.Tensor, network: NetworkState) -> "Views":
        """Views into `flat`, whose length is the number of parameters of the network."""
        arrays = _arrays(network)
        pieces = flat.split([array.size for array in arrays])
        parts = [piece.view(array.shape) for piece, array in zip(pieces, arrays, strict=True)]
        layers = len(network.weights)
        return Views(flat, parts[:layers], parts[layers:-2], parts[-2], parts[-1])


def _arrays(network: NetworkState) -> list[Array32]:
    return [*network.weights, *network.biases, network.last_layer, network.last_bias]


def parameters_of(network: NetworkState) -> Views:
    """A copy of the network's parameters as one flat vector with views."""
    flat = torch.cat([torch.from_numpy(array.reshape(-1)) for array in _arrays(network)])
    return Views.of(flat, network)


def layer_outputs(z: torch.Tensor, parameters: Views) -> list[torch.Tensor]:
    """h_0 = z [C, m, n], h_1, ..., h_L; the last is Phi without its constant."""
    outputs = [z]
    for W, b in zip(parameters.weights, parameters.biases, strict=True):
        outputs.append(_affine(outputs[-1], W.mT, b.mT).tanh_())
    return outputs


def _affine(below: torch.Tensor, W: torch.Tensor, b: torch.Tensor, out: torch.Tensor | None = None) -> torch.Tensor:
    """W h_(l-1) + b, W [C, out, in]. In two steps: torch.baddbmm, which broadcasts b, takes longer than both."""
    return torch.bmm(W, below, out=out).add_(b)


def predictions(z: torch.Tensor, parameters: Views) -> torch.Tensor:
    """y_hat = theta' Phi + theta_0, [C, 3, n], at inputs z [C, m, n]."""
    return _affine(layer_outputs(z, parameters)[-1], parameters.last_layer.mT, parameters.last_bias.mT)


@dataclass(frozen=True, slots=True, eq=False)
class _Layer:
    """A layer on mini-batches of M samples: its views, and the memory it writes to."""

    WT: torch.Tensor
    """W', [C, in, out]; W' delta is what the layer below gets."""
    W: torch.Tensor
    """[C, out, in]"""
    b: torch.Tensor
    """[C, out, 1]"""
    gradient_WT: torch.Tensor
    """dL/dW', written by every mini-batch."""
    gradient_b: torch.Tensor
    """dL/db, written by every mini-batch."""
    output: torch.Tensor
    """[C, out, M]"""
    delta: torch.Tensor
    """dL/d(W h + b), [C, out, M]."""
    deltaT: torch.Tensor
    """delta', [C, M, out]."""

    @staticmethod
    def all_of(parameters: Views, gradient: Views, rows: int) -> list["_Layer"]:
        """All layers; theta with theta_0 is the last."""
        weights, biases = [*parameters.weights, parameters.last_layer], [*parameters.biases, parameters.last_bias]
        of_weights, of_biases = [*gradient.weights, gradient.last_layer], [*gradient.biases, gradient.last_bias]
        layers = []
        for W, b, of_W, of_b in zip(weights, biases, of_weights, of_biases, strict=True):
            own_rows = rows * weights[0].shape[0] // W.shape[0]
            output, delta = torch.zeros(2, W.shape[0], W.shape[2], own_rows, dtype=FLOAT)
            layers.append(_Layer(W, W.mT, b.mT, of_W, of_b.mT, output, delta, delta.mT))
        return layers

    def write_gradient(self, below: torch.Tensor) -> None:
        """dL/dW' = h_(l-1) delta', dL/db = sum of delta over the samples; `below` is h_(l-1), [C, in, M]."""
        torch.bmm(below, self.deltaT, out=self.gradient_WT)
        torch.sum(self.delta, 2, keepdim=True, out=self.gradient_b)


class LossGradient:
    """Gradient of L over mini-batches of one size.

    Views and memory are made once; making them for each mini-batch would take a seventh of its time.

    Parameters
    ----------
    parameters: of the network; read at every mini-batch.
    gradient: the gradient is written to it.
    rows: M, samples per mini-batch.
    """

    def __init__(self, parameters: Views, gradient: Views, rows: int) -> None:
        *self._inner, self._last = _Layer.all_of(parameters, gradient, rows)
        self._channels = parameters.weights[0].shape[0]
        self._vehicles = parameters.last_layer.shape[0] // self._channels
        self._derivative = 2.0 / self._last.output.numel()

    def at(
        self, z: torch.Tensor, y: torch.Tensor, known: torch.Tensor | None, dropout: torch.Tensor | None
    ) -> torch.Tensor:
        """Write the gradient at a mini-batch; returns y_hat - y, [C V, 3, M / V], which the next call overwrites.

        Parameters
        ----------
        z: scaled inputs, [C, m, M].
        y: labels, [C V, 3, M / V].
        known: 1 where the sample has a label, else 0, [C V, 1, M / V]; None if all have one.
        dropout: factors on the features, [C, k - 1, M]; None for no dropout.
        """
        last, h = self._last, [z]
        for layer in self._inner:  # h_l = tanh(W_l h_(l-1) + b_l)
            h.append(_affine(h[-1], layer.W, layer.b, layer.output).tanh_())
        Phi = self._apart(h[-1] if dropout is None else h[-1] * dropout)
        errors = _affine(Phi, last.W, last.b, last.output).sub_(y)  # theta' Phi + theta_0 - y
        if known is not None:
            errors.mul_(known)
        torch.mul(errors, self._derivative, out=last.delta)  # delta_y = 2 errors / (3 C M)
        last.write_gradient(Phi)
        above = last
        for layer, below in zip(reversed(self._inner), reversed(h[:-1]), strict=True):
            if above is last and self._vehicles > 1:
                layer.delta.copy_(self._together(torch.bmm(above.WT, above.delta)))
            else:
                torch.bmm(above.WT, above.delta, out=layer.delta)  # W_(l+1)' delta_(l+1)
            if above is last and dropout is not None:
                layer.delta.mul_(dropout)
            _tanh_backward(layer.delta, layer.output, grad_input=layer.delta)  # delta_l = ... (1 - h_l^2)
            layer.write_gradient(below)
            above = layer
        return errors

    def _apart(self, stacked: torch.Tensor) -> torch.Tensor:
        """[C, k, M] to [C V, k, M / V]: each vehicle's samples for its own last layer."""
        if self._vehicles == 1:
            return stacked
        return stacked.unflatten(2, (self._vehicles, -1)).transpose(1, 2).flatten(0, 1)

    def _together(self, stacked: torch.Tensor) -> torch.Tensor:
        """[C V, k, M / V] to [C, k, M]."""
        return stacked.unflatten(0, (self._channels, -1)).transpose(1, 2).flatten(2)


class Optimiser:
    """Adam, or SGD with momentum, on one flat vector.

    Parameters
    ----------
    moments: of the round before, to continue from; empty to start.
    steps: steps already taken with these moments.
    """

    def __init__(self, config: TrainerConfig, size: int, moments: tuple[Array32, ...], steps: int) -> None:
        self._config = config
        count = 2 if config.optimiser == "adam" else 1
        fits = len(moments) == count and all(moment.size == size for moment in moments)
        start = [torch.from_numpy(moment.copy()) for moment in moments] if fits else []
        self._moments = start or [torch.zeros(size, dtype=FLOAT) for _ in range(count)]
        self.steps = steps if fits else 0
        self._step = torch.tensor(0.0, dtype=FLOAT)

    @property
    def moments(self) -> tuple[Array32, ...]:
        """The moments, for the next round."""
        return tuple(moment.numpy().copy() for moment in self._moments)

    def step(self, parameters: torch.Tensor, gradient: torch.Tensor) -> None:
        """One step, in place. The gradient is overwritten."""
        self.steps += 1
        if self._config.optimiser == "adam":
            self._adam(parameters, gradient)
        else:
            # g <- g + decay p,  m <- momentum m + g,  p <- p - rate m
            gradient.add_(parameters, alpha=self._config.weight_decay)
            m = self._moments[0].mul_(self._config.momentum).add_(gradient)
            parameters.add_(m, alpha=-self._config.learning_rate)

    def _adam(self, parameters: torch.Tensor, gradient: torch.Tensor) -> None:
        """Adam (Kingma and Ba 2015), t-th step.

        g <- g + decay p,  m <- beta1 m + (1 - beta1) g,  v <- beta2 v + (1 - beta2) g^2,
        p <- p - rate (m / (1 - beta1^t)) / (sqrt(v / (1 - beta2^t)) + eps)

        By the kernel behind torch.optim.Adam(fused=True): the class takes 70 us a step, the kernel 5.
        """
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
