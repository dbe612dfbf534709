"""The bumpless swap: new features in flight without a jump of nu_ad.

New inner layers change Phi to Phi_bar. Keeping W would make nu_ad jump by eps_2(x) = W'Phi_bar(x) - W'Phi(x). Instead
W_new is the minimiser of

    sum over recent states norm(W_new' Phi_bar(x_i) - W' Phi(x_i))^2 + mu norm(W_new - W_bar)^2,

so that nu_ad is continuous at the recent states, and W is near W_bar elsewhere. The recent states are those of the last
second, the present state, and the look-ahead state, where the commanded nu_ad is evaluated. eps_2 is then measured on
the same states. A swap with too large an eps_2 is refused.

W_bar is between the trained last layer theta_n and W: W_bar = theta_n + s (W - theta_n). s is the resemblance of the
new features to the old ones, from 0 to 1. W contains what adaptation has learnt since the samples were taken, but it
belongs to the old features. So entirely new features start from theta_n, and features that were only refined keep W. s
is measured on the recent states too: features that agree there and differ elsewhere keep W elsewhere.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from configs.loader import ConfigRecord
from onboard.control.features import Features
from onboard.control.laws.last_layer import PROJECTION_MARGIN
from protocol.conventions import Array
from protocol.feature_set import AXES


class SwapConfig(ConfigRecord):
    """Limits of the swap."""

    memory_weight: Annotated[float, Field(gt=0, description="mu per recent state: pull towards W_bar")] = 0.05
    ring_size: Annotated[int, Field(ge=4, le=200, description="recent states kept")] = 40
    ring_period_ticks: Annotated[int, Field(ge=1, le=100, description="ticks between two of them")] = 5
    jump_max: Annotated[float, Field(gt=0, description="largest eps_2 accepted, units of u")]
    lipschitz_max: Annotated[float, Field(gt=0, description="largest Lipschitz constant of Phi accepted")] = 200.0
    naive: Annotated[bool, Field(description="ablation: keep W as it is instead of the bumpless swap")] = False


class RecentStates:
    """Ring buffer of recent signal vectors, and of the residual at each."""

    def __init__(self, size: int, signal_count: int, outputs: int = AXES) -> None:
        self._ring: Array = np.zeros((size, signal_count))
        self._residuals: Array = np.zeros((size, outputs))
        self._filled = 0
        self._next = 0
        self.pushes = 0
        """States added so far, those that were replaced counted too."""

    def push(self, signals: Array, residual: Sequence[float] | None = None) -> None:
        """Add one signal vector, [SIGNAL_COUNT], and the filtered residual there; they replace the oldest."""
        self._ring[self._next] = signals
        self._residuals[self._next] = 0.0 if residual is None else residual
        self._next = (self._next + 1) % self._ring.shape[0]
        self._filled = min(self._filled + 1, self._ring.shape[0])
        self.pushes += 1

    def columns(self, now: Array) -> Array:
        """[SIGNAL_COUNT, n + m]: the n of the ring and the m of `now`, unordered; no column while the ring is empty."""
        if self._filled == 0:
            return np.zeros((self._ring.shape[1], 0))
        return np.hstack([self._ring[: self._filled].T, now])

    def newest(self) -> tuple[Array, Array]:
        """The last one added: signal vector [SIGNAL_COUNT] and residual [3]."""
        return self._ring[self._next - 1], self._residuals[self._next - 1]

    def in_order(self) -> tuple[Array, Array]:
        """Signal vectors [SIGNAL_COUNT, n] and residuals [n, 3], the oldest first."""
        oldest = self._next if self._filled == self._ring.shape[0] else 0
        order = (oldest + np.arange(self._filled)) % self._ring.shape[0]
        return self._ring[order].T, self._residuals[order]


@dataclass(frozen=True, slots=True, eq=False)
class SwapPlan:
    """The result of planning a swap."""

    W: Array
    """[k, 3], the last layer for the new features."""
    jump: float
    """eps_2: largest norm of the change of nu_ad over the recent states, units of u."""
    refusal: str
    """Empty if the swap may be carried out, else a name of protocol.messages.REFUSALS."""
    theta: Array
    """[k, 3], theta_n that flies with W."""
    step: float = 0.0
    """The jump of nu_cmd, at the state ahead, units of u."""


def plan_swap(
    config: SwapConfig, old: Features, W: Array, new: Features, memory: Array, weight_norm_max: float, recent: Array
) -> SwapPlan:
    """Plan the swap from `old` with W [k, 3] to `new` with theta_n `memory` [k_new, 3].

    Parameters
    ----------
    recent: [SIGNAL_COUNT, n], recent states; with n = 0, W_new = theta_n.
    weight_norm_max: W_max; a theta_n outside the ball is refused.
    """
    if new.lipschitz > config.lipschitz_max:
        return SwapPlan(memory, 0.0, "lipschitz", memory)
    if float(np.linalg.norm(memory)) > weight_norm_max:
        return SwapPlan(memory, 0.0, "weight_norm", memory)
    if recent.shape[1] == 0:
        return SwapPlan(memory, 0.0, "", memory)
    Phi = old.evaluate(old.select(recent))
    nu_before = W.T @ Phi
    Phi_bar = new.evaluate(new.select(recent))
    if config.naive:
        W_new = W if W.shape == memory.shape else memory
    else:
        W_bar = memory + resemblance(Phi, Phi_bar) * (W - memory) if W.shape == memory.shape else memory
        W_new = bumpless_last_layer(Phi_bar, nu_before, W_bar, config.memory_weight * recent.shape[1])
    change = W_new.T @ Phi_bar - nu_before
    jump = float(np.sqrt((change * change).sum(axis=0).max()))
    if not np.isfinite(jump):
        return SwapPlan(W_new, jump, "not_finite", memory)
    if float(np.linalg.norm(W_new)) > weight_norm_max * (1.0 + PROJECTION_MARGIN) ** 0.5:
        return SwapPlan(W_new, jump, "weight_norm", memory)
    step = float(np.sqrt(np.square(change[:, -1]).sum()))
    return SwapPlan(W_new, jump, "swap_jump" if jump > config.jump_max else "", memory, step)


def resemblance(Phi: Array, Phi_bar: Array) -> float:
    """Resemblance of new to old features: 1 - norm(Phi_bar - Phi) / norm(Phi), at least 0.

    Parameters
    ----------
    Phi, Phi_bar: [k, n] features of the same states. The last row, the bias, does not count.
    """
    size = float(np.linalg.norm(Phi[:-1]))
    change = float(np.linalg.norm(Phi_bar[:-1] - Phi[:-1]))
    return 1.0 - change / size if change < size else 0.0


def bumpless_last_layer(Phi_bar: Array, nu: Array, W_bar: Array, mu: float) -> Array:
    """W_new = argmin sum norm(W_new' Phi_bar_i - nu_i)^2 + mu norm(W_new - W_bar)^2.

    Parameters
    ----------
    Phi_bar: [k, n] new features of the recent states. nu: [3, n] nu_ad at these states before the swap. W_bar: [k, 3].
    """
    k = Phi_bar.shape[0]
    gram: Array = Phi_bar @ Phi_bar.T
    gram.flat[:: k + 1] += mu
    mismatch: Array = Phi_bar @ (nu - W_bar.T @ Phi_bar).T
    correction: Array = np.linalg.solve(gram, mismatch).astype(np.float64)
    return W_bar + correction
