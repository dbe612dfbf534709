"""How far the changes of a map have come true: the share of its look-ahead that is flown.

A law that follows the residual within some hundredths of a second needs no map for what changes slowly. The map pays
by the change that it foretells, W'Phi_a - W'Phi_p from the place on the path now to the one ahead. A map of noise
foretells changes too, and reading it ahead then adds an error that the law cannot take back. So that change counts by
its skill,

    g = argmin sum_i (r'_i - g m'_i)^2 + R g^2 = sum r' m' / (sum m'^2 + R)     in each axis, within 0 to 1

with r' the residual r and m' the map W'Phi at the present state, both without what changes more slowly than SLOW_S.
r is newer than everything that W was learnt from, so noise in the labels does not count as skill. R, the variance of r
in a tick, makes g the mean of a slope of which nothing was known but that it is about 0 +- 1. A strong disturbance
weighs more than much still air, and is forgotten within MEMORY_S.
"""

from typing import Final

SLOW_S: Final = 0.3
"""Time constant of what counts as slow: a few times the look-ahead and the law's own lag together."""
MEMORY_S: Final = 20.0
"""Time constant of the sums: some laps."""


class ForecastSkill:
    """g of each axis of one channel. It starts at 0: what has not come true is not flown ahead."""

    def __init__(self, noise_variance: float, axes: int) -> None:
        """noise_variance: R, of the residual of a tick, units of u squared."""
        self.shares = [0.0] * axes
        """g, [axes]."""
        self._noise_variance = noise_variance
        self._slow_residual, self._slow_map = [0.0] * axes, [0.0] * axes
        self._agreed, self._moved = [0.0] * axes, [0.0] * axes
        self._continues = False

    def restart(self) -> None:
        """Another map follows: its step from the one before is no change that it foretold."""
        self._continues = False

    def step(self, residual: list[float], of_map: list[float], dt: float) -> None:
        """One tick.

        Parameters
        ----------
        residual: [axes], as the law takes it, units of u.
        of_map: [axes], W'Phi at the present state, before this residual corrected W.
        dt: s.
        """
        if not self._continues:
            self._slow_map[:] = of_map
            self._continues = True
        share, keep = dt / (SLOW_S + dt), MEMORY_S / (MEMORY_S + dt)
        least = self._noise_variance * dt
        for i, (r, m) in enumerate(zip(residual, of_map, strict=True)):
            fast_residual, fast_map = r - self._slow_residual[i], m - self._slow_map[i]
            self._slow_residual[i] += share * fast_residual
            self._slow_map[i] += share * fast_map
            agreed = self._agreed[i] = keep * (self._agreed[i] + dt * fast_residual * fast_map)
            moved = self._moved[i] = keep * (self._moved[i] + dt * fast_map * fast_map)
            self.shares[i] = min(max(agreed / (moved + least), 0.0), 1.0)
