"""What a map says at the vehicle beside its path, as far as the law (2a) commands it.

The map is read on the path, so it is no feedback. Its deviation m = W'Phi(x) - W'Phi(x_p) is commanded behind a filter:
the one by which the law itself takes up a misfit, tracking term included. The law does so through the residual r and
the error e of the reference model, with e_dot_dot = -K_1 e - K_2 e_dot + nu - r. Here m takes the place of r, and the
gap that of nu:

    e_g_dot_dot = -K_1 e_g - K_2 e_g_dot + gap - m
    gap += s / (R_t + s) (m - gap - t e_g'PB) - s_b dt gap

A slope of the map over x then comes into nu_cmd by the gap, and into b and W by the residual with the other sign,
through the same filter: it is no feedback, whatever its size and the gains are (experiments/margins/kalman.py).
"""

from collections.abc import Sequence

from protocol.conventions import Array


class PathGap:
    """The gap of each axis of one channel."""

    def __init__(self, PB: Array, gains: Sequence[tuple[float, float]]) -> None:
        """PB: [n, q], weights of e in the tracking term. gains: (K_1, K_2) of the reference model, of each axis."""
        half, q = PB.shape[0] // 2, PB.shape[1]
        weights = [(float(PB[i, i]), float(PB[half + i, i])) if i < half else (0.0, 0.0) for i in range(q)]
        self._axes = tuple((*gain, *weight) for gain, weight in zip(gains, weights, strict=True))
        self.values = [0.0] * q
        """[q], units of u."""
        self._error, self._rate = [0.0] * q, [0.0] * q

    def close(self, deviation: Sequence[float] | None = None) -> None:
        """The deviation m [q] counts in full; None: there is none."""
        q = len(self.values)
        self.values[:] = [0.0] * q if deviation is None else deviation
        self._error, self._rate = [0.0] * q, [0.0] * q

    def step(self, deviation: Sequence[float], share: float, keep: float, t: float, dt: float) -> None:
        """One tick.

        Parameters
        ----------
        deviation: m, [q].
        share: s / (R_t + s) of the law's tick.
        keep: 1 - s_b dt, by the share that b has in s.
        t: factor of e'PB.
        dt: s.
        """
        values, error, rate = self.values, self._error, self._rate
        for i, (m, (k_1, k_2, w_1, w_2)) in enumerate(zip(deviation, self._axes, strict=True)):
            pull = dt * (values[i] - m - k_1 * error[i])
            rate[i] = (rate[i] + pull) / (1.0 + dt * (k_2 + dt * k_1))  # implicit: stable at any dt
            error[i] += dt * rate[i]
            kept = keep * values[i]
            values[i] = kept + share * (m - kept - t * (w_1 * error[i] + w_2 * rate[i]))
