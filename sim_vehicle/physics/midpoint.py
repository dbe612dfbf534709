"""One step of the midpoint rule as a method of scipy's `solve_ivp`, by which RotorPy integrates.

RotorPy's usual method, RK45 with error control, evaluates the derivative at least eight times in a step, and its object
refers to itself, so that a process without garbage collection would grow with every step.
"""

from collections.abc import Callable
from typing import Any

from scipy.integrate import OdeSolver

from protocol.conventions import Array


class Midpoint(OdeSolver):  # type: ignore[misc]
    """The whole interval in one step of second order. Arguments and attributes are those that `solve_ivp` uses."""

    def __init__(
        self, fun: Callable[[float, Array], Array], t0: float, y0: Array, t_bound: float, **ignored: Any
    ) -> None:
        self.fun, self.t_old, self.t, self.y, self.t_bound = fun, t0, t0, y0, t_bound
        self.status = "running"
        self.nfev = self.njev = self.nlu = 0

    def step(self) -> None:
        """Advance to the end of the interval."""
        half = 0.5 * (self.t_bound - self.t)
        middle = self.fun(self.t + half, self.y + half * self.fun(self.t, self.y))
        self.y = self.y + 2.0 * half * middle
        self.t, self.nfev, self.status = self.t_bound, 2, "finished"
