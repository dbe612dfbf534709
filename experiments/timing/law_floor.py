"""The lower bound of the control law's time: only its numpy calls."""

import time
from collections.abc import Callable
from itertools import pairwise
from typing import Final

import numpy as np

from experiments.flights.scenario import FlightConfig
from experiments.timing.step_timing import quantiles_us
from protocol.signals import SIGNAL_COUNT

FLOOR_CALLS: Final = 3000


def law_floor_us(config: FlightConfig) -> float:
    """Return the p50 of the numpy calls in the control law of both channels, in a tight loop.

    Inputs are selected, scaled and limited; each layer is a product and a tanh; then W'Phi and the law's update. All
    act on two columns, for the present state and the look-ahead state.
    """
    calls = [_bare_law(features) for features in _features_like(config)]
    durations = []
    for _ in range(FLOOR_CALLS):
        start = time.perf_counter_ns()
        for call in calls:
            call()
        durations.append(time.perf_counter_ns() - start)
    return quantiles_us(durations)[0]


def _features_like(config: FlightConfig) -> list[tuple[int, ...]]:
    """Widths of each learnt network: inputs, hidden layers, features without the constant."""
    trained = config.features.trained
    hidden = (*trained.hidden, trained.count - 1)
    return [(len(trained.inputs(channel)), *hidden) for channel in trained.channels]


def _bare_law(widths: tuple[int, ...]) -> Callable[[], None]:
    rng = np.random.default_rng(1)
    weights = [rng.normal(size=(after, before + 1)) for before, after in pairwise(widths)]
    levels = [np.ones((width + 1, 2)) for width in widths]
    layers = [(W, below, above[:-1]) for W, below, above in zip(weights, levels, levels[1:], strict=False)]
    inputs, signals, chosen = levels[0][:-1], rng.normal(size=(SIGNAL_COUNT, 2)), np.arange(widths[0])
    offset, scale, limit = (np.ones_like(inputs) for _ in range(3))
    last, update = rng.normal(size=(levels[-1].shape[0], 3)), np.empty((levels[-1].shape[0], 3))
    error, PB, direction = np.ones(6), np.ones((6, 3)), np.zeros(3)

    def call() -> None:
        z = signals.take(chosen, axis=0)
        np.subtract(z, offset, out=z)
        np.multiply(z, scale, out=z)
        np.minimum(z, limit, out=z)
        np.maximum(z, limit, out=z)
        inputs[:] = z
        for W, below, above in layers:
            np.dot(W, below, out=above)
            np.tanh(above, out=above)
        Phi = levels[-1].copy()
        now = Phi[:, 0]
        now.dot(now)
        error.dot(PB)
        now.dot(last)
        np.multiply(now[:, None], direction, out=update)
        np.add(last, update, out=last)
        np.vdot(last, last)
        np.dot(last.T, Phi)

    return call
