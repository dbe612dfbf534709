"""The slope of W'Phi over the state, kept within its limits while W is learnt.

A map over the state is feedback (onboard.control.slope). At a swap the slope of theta'Phi is bounded; what W learns in
flight adds to it: features that were never trained answer an oscillation with feedback of their own.

For an axis, with w = theta + X its weights and A = dPhi'/dx over the inputs x that the loop knows, each in units that
make its limit 1, norm(A w) <= 1 is a convex set of X. X goes to the nearest point of it in the metric of
S^-1,

    X <- X - mu S A'y,    y = (I + mu A S A')^-1 A w,    mu > 0 so that norm(y) = 1.

That flattens the map where little was measured, and hardly changes it where much was. For any X* in the set, that is,
for a Delta that is no steeper itself, tr(X~'S^-1 X~) does not grow by it (docs/theory_covariance.md).

Bounded is the slope at the present state: what it says about the vehicle beside the path is what feeds back.
"""

from typing import Final

import numpy as np

from onboard.control.features import Features
from onboard.control.laws.kalman_state import KalmanState, multiplier
from onboard.control.slope import SlopeLimits
from protocol.conventions import Array

PERIOD_TICKS: Final = 4
"""Between two checks."""
HERE: Final = 0
"""Column of the present state in Phi."""


class SlopeBound:
    """The bound for the features of one channel."""

    def __init__(self, inputs: tuple[str, ...], limits: SlopeLimits, ticks: int = 0) -> None:
        """inputs: names of the signals that the features see. ticks: of the bound before: a swap moves no check."""
        known = [(inputs.index(name), limit) for names, limit in limits.groups for name in names if name in inputs]
        self._inputs = np.array([index for index, _ in known], dtype=np.intp)
        self._units = np.array([1.0 / limit for _, limit in known]).T
        self.ticks = ticks

    def step(self, features: Features, state: KalmanState) -> None:
        """One tick: every PERIOD_TICKS-th bounds the slope at the last Phi of the features."""
        if self.ticks % PERIOD_TICKS == 0 and self._inputs.size > 0:
            bound_slopes(state, features.slope(HERE, self._inputs), self._units)
        self.ticks += 1


def bound_slopes(state: KalmanState, J: Array, units: Array) -> None:
    """Project the X of every axis onto the weights whose slope is within its limit, in the metric of S^-1.

    Parameters
    ----------
    J: [k - 1, n], dPhi/dx over n inputs, without the constant.
    units: [3, n], one over the limit of each axis: the slope is norm((theta + X)'J units).
    """
    slopes = np.dot(state.theta_rows[:, :-2] + state.X_rows[:, :-2], J) * units
    sizes = np.square(slopes).sum(axis=1).tolist()
    steep = [axis for axis, size in enumerate(sizes) if size > 1.0]
    if not steep:
        return
    along = np.dot(state.S[:, :-2], J)
    among = np.dot(J.T, along[:-2])
    for axis in steep:
        unit = units[axis]
        s, axes = np.linalg.eigh(unit[:, None] * among * unit)
        a = slopes[axis].dot(axes)
        mu = multiplier(a * a, s, 1.0)
        state.X_rows[axis] -= along.dot(unit * axes.dot(a * (mu / (1.0 + mu * s))))
