"""Mean X and covariance S of a Kalman filter whose states revert to their prior, each at a rate of its own.

    predict:  X <- D X,                       S <- D S D + (I - D^2) S0,    D = diag(exp(-s_i dt)), S0 diagonal
    correct:  X <- X + g (y - X'phi)' / v,    S <- S - g g' / v,            g = S phi,  v = R + phi'S phi

S stays symmetric and positive definite in any precision, for any number of steps:
- Symmetric to the bit: D S D is an elementwise product with a symmetric matrix, and u u', u = g / sqrt(v), has equal
  numbers on both sides of its diagonal, because a product of two floating-point numbers commutes.
- Positive definite: in units of S0, the smallest eigenvalue of S is at least f = min_i (1 - d_i^2) after a prediction,
  and at least f / (1 + f phi'S0 phi / R) after the correction that follows. Rounding of a step changes S by less than
  that as long as `rounding_share` is below 1 (docs/theory_covariance.md). Nothing accumulates: each prediction restores
  f.
- S <= S0 always, so it does not wind up while nothing is excited.

theta', X' and S are the rows of one array, so that one product evaluates them along phi, and one rank-one update with
[d; u] u' corrects X' and S. numpy's time is that of its calls.
"""

from math import exp, expm1
from typing import Final

import numpy as np

from protocol.conventions import Array

MULTIPLIER_STEPS: Final = 8
"""Newton steps of `multiplier`, at most."""
MULTIPLIER_TOLERANCE: Final = 1e-9
"""Relative, of its square of the norm."""


class KalmanState:
    """X [n, q] and S [n, n], beside a constant theta [n, q], in the precision of the prior variances.

    q is the number of outputs, which share S: 3 axes in a channel of the vehicle.
    """

    def __init__(self, theta: Array, prior_variance: Array, rates_1_s: Array) -> None:
        """Start from X = 0 and S = S0.

        Parameters
        ----------
        prior_variance: [n], the diagonal of S0.
        rates_1_s: [n], s_i.
        """
        n, q, dtype = prior_variance.size, theta.shape[1], prior_variance.dtype
        self.prior_variance, self._rates = prior_variance, rates_1_s
        self.outputs = q
        self._rows: Array = np.zeros((2 * q + n, n), dtype=dtype)
        self.theta_rows, self.X_rows, self.S = self._rows[:q], self._rows[q : 2 * q], self._rows[2 * q :]
        """theta' [q, n], X' [q, n] and S [n, n]."""
        self.theta_rows[:] = theta.T
        self._moving, self._diagonal = self._rows[q:], self.S.reshape(-1)[:: n + 1]
        self._diagonal[:] = prior_variance
        self._keep: Array = np.ones((q + n, n), dtype=dtype)
        self._gain: Array = np.zeros(n, dtype=dtype)
        self._change: Array = np.empty((q + n, n), dtype=dtype)
        self._left: Array = np.empty((q + n, 1), dtype=dtype)
        self._of_X = self._left[:q, 0]
        self._u, self._u_row = self._left[q:, 0], self._left[q:].T
        self._dt = 0.0

    def predict(self, dt: float) -> None:
        """X <- D X, S <- D S D + (I - D^2) S0, over dt, s."""
        if dt != self._dt:
            self._dt = dt
            d = np.array([exp(-rate * dt) for rate in self._rates.tolist()])
            self._keep[: self.outputs], self._keep[self.outputs :] = d, d[:, None] * d
            each_state = zip(self._rates.tolist(), self.prior_variance.tolist(), strict=True)
            self._gain[:] = [-expm1(-2.0 * rate * dt) * variance for rate, variance in each_state]
        np.multiply(self._moving, self._keep, out=self._moving)
        np.add(self._diagonal, self._gain, out=self._diagonal)

    def along(self, columns: Array) -> Array:
        """theta', X' and S times columns [n, m]: [2 q + n, m]."""
        product: Array = self._rows.dot(columns)
        return product

    def correct(self, g: Array, innovation: list[float], v: float) -> None:
        """X <- X + g innovation' / v, S <- S - g g' / v.

        Parameters
        ----------
        g: [n], S phi.
        innovation: [q], y - X'phi.
        v: R + phi'S phi.
        """
        root = v**-0.5
        np.multiply(g, root, out=self._u)
        self._of_X[:] = [-d * root for d in innovation]
        np.dot(self._left, self._u_row, out=self._change)
        np.subtract(self._moving, self._change, out=self._moving)


def multiplier(squares: Array, s: Array, radius: float) -> float:
    """mu >= 0 with sum_j squares_j / (1 + mu s_j)^2 = radius^2, for squares [n] that sum up to more, and s [n] >= 0.

    Newton's method on 1 / norm, which is concave and nearly linear in mu: it comes from below and stays there.
    """
    mu, weighted = 0.0, squares * s
    for _ in range(MULTIPLIER_STEPS):
        left = 1.0 / (1.0 + mu * s)
        left2 = left * left
        norm2 = float(squares.dot(left2))
        if norm2 <= (1.0 + MULTIPLIER_TOLERANCE) * radius * radius:
            break
        slope = float(weighted.dot(left2 * left)) / norm2**1.5  # of 1 / norm
        mu += (1.0 / radius - norm2**-0.5) / slope
    return mu


def rounding_share(
    prior_variance: Array, rates_1_s: Array, noise_variance: float, dt: float, dtype: type[np.floating] = np.float32
) -> float:
    """How much of the smallest eigenvalue of S the rounding of one step may take: below 1, S stays positive definite.

    For features of at most 1 in magnitude; a bound on the worst case (docs/theory_covariance.md), not an estimate.
    """
    n, unit = prior_variance.size, float(np.finfo(dtype).eps) / 2.0
    phi2 = float(prior_variance.sum())  # in units of S0, in which S is at most I
    floor = float((-np.expm1(-2.0 * rates_1_s * dt)).min())
    left = floor / (1.0 + floor * phi2 / noise_variance)
    of_g = n**1.5 * unit * (phi2 / noise_variance) ** 0.5
    return float((4.0 * unit * n**0.5 + 2.0 * of_g + of_g * of_g) / left)
