"""Whether a sample is new, and which stored sample it replaces: see docs/learning.md.

All updates are incremental: no p x p factorisation when a sample is stored or replaced.
"""

import math
from typing import Final

import numpy as np
from scipy.linalg import blas

from protocol.conventions import Array

JITTER: Final = 1e-4
"""Added to the diagonal of the kernel matrix, so that it stays well conditioned."""
FIRST_ALLOCATION: Final = 128
EMPTY: Final = -1
"""The condition of an empty slot."""
RANK_TOLERANCE: Final = 1e-3
"""Share of a vector's length that must be outside a span for the vector to add a direction to it."""
NEWTON_STEPS: Final = 50


class KernelNovelty:
    """gamma = k(x, x) - k_X' K^-1 k_X: the part of a new point that the stored points do not explain (sparse GP).

    k is the Gaussian kernel of unit width on inputs that the caller has scaled, k(x, x) = 1, and
    K = k(X, X) + JITTER I over the stored points X. Each point has the number of a condition; k is zero between points
    of two conditions, so that a point is new unless points of its own condition explain it. K^-1 is held in the upper
    triangle of an array with a row and a column per slot; those of an empty slot are zero, so that adding a point is a
    symmetric rank-one update in place, and replacing one a rank-two update.
    """

    def __init__(self, capacity: int, inputs: int) -> None:
        self._capacity = capacity
        self._X = np.zeros((capacity, inputs))
        self._condition = np.full(capacity, EMPTY)
        self._K_inverse = np.zeros((0, 0), order="F")
        self._asked: tuple[Array, int, Array, Array] | None = None

    def _allocate(self, slot: int) -> None:
        size = self._K_inverse.shape[0]
        new_size = min(self._capacity, max(FIRST_ALLOCATION, 2 * size, slot + 1))
        grown = np.zeros((new_size, new_size), order="F")
        grown[:size, :size] = self._K_inverse
        self._K_inverse = grown
        self._asked = None

    def _kernel(self, x: Array, condition: int) -> Array:
        """k_X = exp(-norm(X - x)^2 / 2), zero at empty slots and at those of other conditions."""
        size = self._K_inverse.shape[0]
        distance = self._X[:size] - x
        k: Array = np.exp(-0.5 * np.einsum("ij,ij->i", distance, distance))
        k *= self._condition[:size] == condition
        return k

    def gamma(self, x: Array, condition: int = 0) -> tuple[float, int]:
        """gamma of the point x [inputs], and the slot of the stored point nearest to it.

        The slot is -1 if no point of the condition is stored.
        """
        if not (self._condition[: self._K_inverse.shape[0]] == condition).any():
            return 1.0, -1
        k, a = self._explain(x, condition)
        return float(1.0 - k @ a), int(np.argmax(k))

    def _explain(self, x: Array, condition: int) -> tuple[Array, Array]:
        """k_X and a = K^-1 k_X, cached: a point that is admitted had its gamma computed just before."""
        if self._asked is None or self._asked[1] != condition or not np.array_equal(self._asked[0], x):
            k = self._kernel(x, condition)
            self._asked = (x.copy(), condition, k, blas.dsymv(1.0, self._K_inverse, k))
        return self._asked[2], self._asked[3]

    def add(self, slot: int, x: Array, condition: int = 0) -> None:
        """Store the point x in an empty slot: K^-1 += u u' / gamma with u = (K^-1 k_X, -1 at the slot)."""
        if slot >= self._K_inverse.shape[0]:
            self._allocate(slot)
        k, a = self._explain(x, condition)
        u = a.copy()
        u[slot] = -1.0
        blas.dsyr(1.0 / (1.0 + JITTER - float(k @ a)), u, a=self._K_inverse, overwrite_a=True)
        self._put(slot, x, condition)

    def replace(self, slot: int, x: Array, condition: int = 0) -> None:
        """Replace the point in a slot by x, in one pass over K^-1 (one read, one write).

        Removal:   K^-1 -= b b', b the slot's column of K^-1 divided by the root of its diagonal element
        Addition:  K^-1 += u u' / gamma as in `add`, u = K^-1 k - b (b' k), k the kernel without the removed point
        Together:  u u' - b b' = ((u - b)(u + b)' + (u + b)(u - b)') / 2
        """
        column = np.concatenate([self._K_inverse[:slot, slot], self._K_inverse[slot, slot:]])
        k_X, a = self._explain(x, condition)
        k = k_X.copy()
        k[slot] = 0.0
        b = column / np.sqrt(column[slot])
        u = a - column * k_X[slot]
        u -= b * float(b @ k)
        u[slot] = 0.0  # exactly zero, like the row of the removed point
        gamma = 1.0 + JITTER - float(k @ u)
        u[slot] = -1.0
        u /= np.sqrt(gamma)
        blas.dsyr2(0.5, u - b, u + b, a=self._K_inverse, overwrite_a=True)
        self._K_inverse[slot, slot] = 1.0 / gamma
        self._put(slot, x, condition)

    def _put(self, slot: int, x: Array, condition: int) -> None:
        self._X[slot] = x
        self._condition[slot] = condition
        self._asked = None


class HistoryNovelty:
    """The test of Chowdhary and Johnson: phi is far from the last stored one, or adds a direction to the stack."""

    def __init__(self, tolerance: float) -> None:
        self._tolerance = tolerance
        self._last: Array | None = None
        self._basis = np.zeros((0, 0))

    def is_new(self, phi: Array) -> bool:
        """Whether norm(phi - phi_last)^2 / norm(phi) >= eps, or rank([stack, phi]) > rank(stack). phi: [k]."""
        if self._last is None:
            return True
        moved = float(np.sum((phi - self._last) ** 2) / np.linalg.norm(phi))
        return moved >= self._tolerance or self._residual(phi) is not None

    def _residual(self, phi: Array) -> Array | None:
        """Unit vector of the part of phi outside the span of the stack; None if it is in the span."""
        if self._basis.shape[0] >= phi.shape[0]:
            return None
        outside = phi - self._basis.T @ (self._basis @ phi) if self._basis.size else phi.copy()
        size = float(np.linalg.norm(outside))
        return outside / size if size > RANK_TOLERANCE * float(np.linalg.norm(phi)) else None

    def add(self, phi: Array) -> None:
        """Add a stored phi [k] to the stack."""
        direction = self._residual(phi)
        if direction is not None:
            self._basis = np.vstack([self._basis.reshape(-1, phi.shape[0]), direction])
        self._last = phi.copy()

    def rebuild(self, gram: Array, last: Array) -> None:
        """Start from another stack (row replaced, or new features): its Phi'Phi [k, k] and the last stored phi [k]."""
        sizes, directions = np.linalg.eigh(gram)  # squares of the stack's singular values
        self._basis = directions[:, sizes > RANK_TOLERANCE**2 * max(float(sizes[-1]), 1e-12)].T
        self._last = last.copy()


def swap_for_largest_sigma_min(Phi: Array, gram: Array, phi_new: Array) -> int:
    """Row i of the stack Phi [p, k] whose replacement by phi_new [k] gives the largest smallest singular value.

    With A = Phi'Phi + phi_new phi_new' = Q diag(l) Q' and z_i = Q' phi_i, the smallest eigenvalue mu_i of
    A - phi_i phi_i' is the root in [0, l_1) of

        g_i(mu) = sum_j z_ij^2 / (l_j - mu) - 1,  and g_i(mu) <= 0 exactly when mu <= mu_i.

    The search starts with the row that has the least share in the weakest direction, and finds its root. One pass
    then drops all rows with a smaller root; the most promising of the rest is solved next, until none is left. This
    takes one k x k decomposition and two or three passes of O(p k) instead of p decompositions.

    Parameters
    ----------
    gram: Phi'Phi, [k, k].
    """
    eigenvalues, Q = np.linalg.eigh(gram + np.outer(phi_new, phi_new))
    if float(eigenvalues[0]) <= 1e-12 * float(eigenvalues[-1]):
        return 0
    z_squared = Phi @ Q
    np.multiply(z_squared, z_squared, out=z_squared)
    rows = np.arange(Phi.shape[0])
    best = int(np.argmin(z_squared[:, 0]))
    low = 0.0
    while True:
        low = _root(z_squared[best], eigenvalues, low)
        shares = z_squared @ (1.0 / (eigenvalues - low))
        shares[best] = np.inf
        left = np.flatnonzero(shares <= 1.0)
        if left.size == 0:
            return int(rows[best])
        best = int(np.argmin(shares[left]))
        rows, z_squared = rows[left], z_squared[left]


def _root(z_squared: Array, eigenvalues: Array, low: float) -> float:
    """The root of g for one row's z_squared [k], not below `low`.

    Newton's method, mu <- mu - g(mu) / g'(mu), from the root that the pole at l_1 alone would give. g is convex and
    rising, so the steps approach the root from the right. A row with no share in the weakest direction has the root
    l_1, apart from rounding.
    """
    smallest = float(eigenvalues[0])
    mu = max(low, min(smallest - float(z_squared[0]), math.nextafter(smallest, 0.0)))
    for _ in range(NEWTON_STEPS):
        inverse = 1.0 / (eigenvalues - mu)
        shares = z_squared * inverse
        step = (float(shares.sum()) - 1.0) / float(shares.dot(inverse))
        if step <= 1e-15 * smallest or mu - step <= low:
            return mu if step <= 0.0 else max(low, mu - step)
        mu -= step
    return mu
