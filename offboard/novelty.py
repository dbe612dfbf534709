"""Is a sample new, and which one should go for it? The two tests and the swap of control.md, section 6.

Everything here is incremental: no p x p factorisation happens when a sample comes or goes.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import blas

Array = NDArray[np.float64]

JITTER: Final = 1e-4
"""Added to the kernel matrix's diagonal, so that its inverse stays harmless."""
FIRST_ALLOCATION: Final = 128
BISECTIONS: Final = 60


class KernelNovelty:
    """gamma = k(x,x) - k_X' K^-1 k_X: the part of a new point that the kept ones do not explain (sparse GP).

    k is the Gaussian kernel of unit width over inputs the caller has scaled, K = k(X, X) + JITTER I over the kept
    points. K^-1 lives in the upper triangle of an array with a row and a column per slot; those of an empty slot
    are zero, so that adding and removing a point are one symmetric rank-one update each, O(p^2), in place.
    """

    def __init__(self, capacity: int, inputs: int) -> None:
        self._capacity = capacity
        self._X = np.zeros((capacity, inputs))
        self._used = np.zeros(capacity)
        self._K_inverse = np.zeros((0, 0), order="F")

    def _allocate(self, slot: int) -> None:
        size = self._K_inverse.shape[0]
        if slot < size:
            return
        new_size = min(self._capacity, max(FIRST_ALLOCATION, 2 * size, slot + 1))
        grown = np.zeros((new_size, new_size), order="F")
        grown[:size, :size] = self._K_inverse
        self._K_inverse = grown

    def _kernel(self, x: Array) -> Array:
        """k_X, zero at empty slots."""
        size = self._K_inverse.shape[0]
        distance = self._X[:size] - x
        k: Array = np.exp(-0.5 * np.einsum("ij,ij->i", distance, distance))
        k *= self._used[:size]
        return k

    def gamma(self, x: Array) -> tuple[float, int]:
        """Novelty of the point x [inputs], and the slot of the kept point most like it (-1 if none is kept)."""
        if self._K_inverse.shape[0] == 0 or not self._used.any():
            return 1.0, -1
        k = self._kernel(x)
        a = blas.dsymv(1.0, self._K_inverse, k)
        return float(1.0 - k @ a), int(np.argmax(k))

    def add(self, slot: int, x: Array) -> None:
        """Keep the point x in an empty slot: K^-1 += u u' / gamma with u = (K^-1 k_X, -1 at the slot)."""
        self._allocate(slot)
        k = self._kernel(x)
        u = blas.dsymv(1.0, self._K_inverse, k)
        gamma = 1.0 + JITTER - float(k @ u)
        u[slot] = -1.0
        blas.dsyr(1.0 / gamma, u, a=self._K_inverse, overwrite_a=True)
        self._X[slot] = x
        self._used[slot] = 1.0

    def remove(self, slot: int) -> None:
        """Forget the point in a slot: K^-1 -= b b' / b_slot with b the slot's column of K^-1."""
        b = np.concatenate([self._K_inverse[:slot, slot], self._K_inverse[slot, slot:]])
        blas.dsyr(-1.0 / b[slot], b, a=self._K_inverse, overwrite_a=True)
        self._K_inverse[: slot + 1, slot] = 0.0
        self._K_inverse[slot, slot:] = 0.0
        self._used[slot] = 0.0


class HistoryNovelty:
    """Chowdhary and Johnson's test: Phi moved far enough from the last one stored, or adds a new direction."""

    def __init__(self, tolerance: float) -> None:
        self._tolerance = tolerance
        self._last: Array | None = None
        self._basis = np.zeros((0, 0))

    def is_new(self, phi: Array) -> bool:
        """norm(Phi - Phi_last)^2 / norm(Phi) >= eps, or rank([stack, Phi]) > rank(stack). phi: [k]."""
        if self._last is None:
            return True
        moved = float(np.sum((phi - self._last) ** 2) / np.linalg.norm(phi))
        return moved >= self._tolerance or self._residual(phi) is not None

    def _residual(self, phi: Array) -> Array | None:
        """Unit vector of the part of phi outside the stack's span, None if there is none."""
        if self._basis.shape[0] >= phi.shape[0]:
            return None
        outside = phi - self._basis.T @ (self._basis @ phi) if self._basis.size else phi.copy()
        size = float(np.linalg.norm(outside))
        return outside / size if size > 1e-3 * float(np.linalg.norm(phi)) else None

    def add(self, phi: Array) -> None:
        """Phi [k] was stored."""
        direction = self._residual(phi)
        if direction is not None:
            self._basis = np.vstack([self._basis.reshape(-1, phi.shape[0]), direction])
        self._last = phi.copy()

    def rebuild(self, Phi: Array, last: int) -> None:
        """The stack is now Phi [p, k] (deletion, or new features); row `last` was stored last."""
        _, sizes, directions = np.linalg.svd(Phi, full_matrices=False)
        self._basis = directions[sizes > 1e-3 * max(float(sizes[0]), 1e-12)]
        self._last = Phi[last].copy()


def best_swap(Phi: Array, gram: Array, phi_new: Array) -> int:
    """Row i of the stack Phi [p, k] whose replacement by phi_new [k] gives the largest smallest singular value.

    With A = Phi'Phi + phi_new phi_new' = Q diag(l) Q' and z_i = Q'phi_i, the smallest eigenvalue mu_i of
    A - phi_i phi_i' is the root of f_i(mu) = 1 - sum_j z_ij^2 / (l_j - mu) in [0, l_1), and f_i(mu) >= 0 exactly
    when mu <= mu_i. So one bisection over mu, which drops candidates as it goes, finds the largest root of all:
    one k x k decomposition and some O(p k) sweeps instead of p decompositions.

    Parameters
    ----------
    gram: Phi'Phi, [k, k].
    """
    eigenvalues, Q = np.linalg.eigh(gram + np.outer(phi_new, phi_new))
    smallest = float(eigenvalues[0])
    alive = np.arange(Phi.shape[0])
    if smallest <= 1e-12 * float(eigenvalues[-1]):
        return 0
    z_squared = (Phi @ Q) ** 2
    low, high = 0.0, smallest
    for _ in range(BISECTIONS):
        if alive.size == 1:
            break
        mu = 0.5 * (low + high)
        keeps = z_squared @ (1.0 / (eigenvalues - mu)) <= 1.0
        if keeps.any():
            low, alive, z_squared = mu, alive[keeps], z_squared[keeps]
        else:
            high = mu
    return int(alive[0])
