"""The swap of the law with a covariance: W, b and S in the new features are the posterior on the recent states.

Prior: W ~ N(theta, S0), b an Ornstein-Uhlenbeck process (sigma_b, s_b). Measured: the filtered residual y_i at the n
states of the last second,

    y_i = W'Phi_bar(x_i) + b(t_i) + v_i,    v_i ~ (0, R dt / (2 T))        T: time constant of the filter

The filter of the law is run over these states from its prior, but for the mean reversion of W within the second. Then b
takes up what is left of the jump of nu at the present state, so that nu is continuous there to rounding. The change of
nu_cmd is measured before anything changes: a swap that would make it jump by more than `jump_max` is refused. eps_2 is
the larger of it and of the change at the present state. A theta that is too steep for the loop is flattened first
(onboard.control.slope).

All of it takes longer than a tick, so it is done in parts, one a tick: `PosteriorSwap`. States that the vehicle passes
meanwhile are followed, so that X and S know everything up to the tick of the swap.
"""

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from onboard.control.feature_swap import RecentStates, SwapConfig, SwapPlan
from onboard.control.features import Features, NetworkFeatures
from onboard.control.laws.kalman_last_layer import KalmanLastLayer, evaluate, prior_variance
from onboard.control.laws.kalman_state import KalmanState
from onboard.control.slope import SlopeLimits, flattened, largest_shares
from protocol.conventions import Array

STATES_PER_PART: Final = 5
"""States whose features one part evaluates."""
SLOPES_PER_PART: Final = 1
"""States whose slope one part evaluates."""
UPDATES_PER_PART: Final = 3
"""States that one part of the filter takes."""
SLOPE_STRIDE: Final = 4
"""Of the recent states every fourth one is checked for its slope: 0.1 s apart."""
FOLLOWED_MAX: Final = 64
"""States taken in addition while the swap is prepared; later ones are left to the law."""
NOW: Final = 3
"""Columns of the present: here, on the path ahead, on the path now."""


@dataclass(frozen=True, slots=True, eq=False)
class PosteriorPlan(SwapPlan):
    """The result of planning a swap of the law with a covariance."""

    X: Array = field(default_factory=lambda: np.zeros((0, 3)))
    """[k + 1, 3], [W - theta; b]."""
    S: Array = field(default_factory=lambda: np.zeros((0, 0)))
    """[k + 1, k + 1]."""


class PosteriorSwap:
    """A swap to new features in parts: network, features, slopes, filter; then `plan`.

    Columns of states: the n of the ring at the start, the NOW of the present then, and those that are followed.
    """

    def __init__(
        self,
        config: SwapConfig,
        law: KalmanLastLayer,
        new: NetworkFeatures,
        limits: SlopeLimits,
        recent: RecentStates,
        now: Array,
        times: tuple[float, float],
    ) -> None:
        """now: [SIGNAL_COUNT, NOW]. times: s, a tick, and between two recent states."""
        self.new, self._config, self._law, self._limits = new, config, law, limits
        self._recent, self._seen = recent, recent.pushes
        signals, residuals = recent.in_order()
        n, q = residuals.shape
        self._n, size = n, n + NOW + FOLLOWED_MAX
        self._states = np.zeros((signals.shape[0], size))
        self._states[:, : n + NOW] = np.hstack([signals, now])
        self._residuals = np.zeros((size, q))
        self._residuals[:n] = residuals
        self._Phi = np.zeros((new.feature_count, size))
        self._count, self._evaluated, self._used = n + NOW, 0, 0
        dt, self._between = times
        self._noise = law.residual_variance(dt)
        self.theta, self.shares = new.channel.last_layer, np.zeros(q)
        """theta [k, q] within the limits of its slope, and the largest slope at the recent states, a share of it."""
        k = new.feature_count
        rates = np.zeros(k + 1)
        rates[-1] = law.config.fast_bias_rate
        self._filter = KalmanState(np.zeros((k + 1, q)), prior_variance(law.config, k), rates)
        self._norms = 1.0
        self._checked = [*range((n - 1) % SLOPE_STRIDE if n else 0, n, SLOPE_STRIDE), *range(n, n + NOW)]
        self._parts = (
            2 * len(new.channel.weights),
            -(-(n + NOW) // STATES_PER_PART),
            -(-len(self._checked) // SLOPES_PER_PART),
            max(-(-n // UPDATES_PER_PART), 1),
        )
        self._stage, self._part = 0, 0
        self.refusal = ""

    def step(self) -> bool:
        """One part; whether it was the last one. With a refusal nothing is left to do."""
        (self._network, self._features, self._slopes, self._update)[self._stage]()
        self._part += 1
        if self._part == self._parts[self._stage]:
            self._stage, self._part = self._stage + 1, 0
        return bool(self.refusal) or self._stage == len(self._parts)

    def follow(self) -> None:
        """Once a tick, before the part: take a state that has come, and what the parts before would do with it."""
        if self._recent.pushes > self._seen and self._count < self._states.shape[1]:
            self._seen = self._recent.pushes
            self._states[:, self._count], self._residuals[self._count] = self._recent.newest()
            self._count += 1
        if self._stage > 1:
            self._evaluate(1)
        if self._stage > 3:
            self._filter_on(1)

    def _network(self) -> None:
        """Layer by layer: take it over (in C), and its spectral norm, a factor of the Lipschitz constant."""
        limit, layer = self._law.config.weight_norm_max, self._part // 2
        if self._part == 0 and float(np.linalg.norm(self.theta)) > limit:
            self.refusal = "weight_norm"
        elif self._part % 2:
            self._norms *= float(np.linalg.norm(self.new.channel.weights[layer], 2))
            if self._part + 1 == self._parts[0] and self._norms > self._config.lipschitz_max:
                self.refusal = "lipschitz"

    def _features(self) -> None:
        self._evaluate(STATES_PER_PART)

    def _evaluate(self, most: int) -> None:
        """Phi of the next states."""
        first, last = self._evaluated, min(self._evaluated + most, self._count)
        if last > first:
            self._Phi[:, first:last] = self.new.evaluate(self.new.select(self._states[:, first:last]))
            self._evaluated = last

    def _slopes(self) -> None:
        """The largest slope at some of the states; the last part flattens what is too steep."""
        checked = self._checked[SLOPES_PER_PART * self._part :][:SLOPES_PER_PART]
        channel = self.new.channel
        states = self._states[:, checked]
        self.shares = np.maximum(self.shares, largest_shares(channel, channel.last_layer, self._limits, states))
        if self._part + 1 == self._parts[2]:
            self.theta, factor = flattened(channel.last_layer, self.shares, self._Phi[:, : self._n + NOW])
            self.shares = self.shares * factor

    def _update(self) -> None:
        self._filter_on(UPDATES_PER_PART)

    def _filter_on(self, most: int) -> None:
        """Take the next measurements."""
        if self._law.config.composite_gain == 0.0:
            return
        one, q = self._filter, self._filter.outputs
        for _ in range(most):
            at = self._used if self._used < self._n else self._used + NOW
            if at >= self._evaluated:
                return
            if self._used > 0:
                one.predict(self._between)
            phi = np.append(self._Phi[:, at], 1.0)
            along = one.along(phi[:, None])[:, 0]
            expected = self.theta.T @ self._Phi[:, at] + along[q : 2 * q]
            g = along[2 * q :]
            one.correct(g, (self._residuals[at] - expected).tolist(), self._noise + float(phi.dot(g)))
            self._used += 1

    @property
    def measured(self) -> tuple[Array, Array]:
        """Phi [k, n] and residuals [n, 3] of the recent states so far."""
        columns = [*range(self._n), *range(self._n + NOW, self._evaluated)]
        return self._Phi[:, columns], self._residuals[columns]

    @property
    def seen(self) -> int:
        """States of the ring that the filter takes, those before the last second counted too: `RecentStates.pushes`."""
        return self._seen

    def plan(self, old: Features, now: Array, since: float) -> PosteriorPlan:
        """The plan, once all parts are done. Nothing changes yet.

        Parameters
        ----------
        old: the features that fly. now: [SIGNAL_COUNT, NOW]. since: s, from the newest recent state to the present.
        """
        law, config, theta = self._law, self._config, self.theta
        if self.refusal:
            return PosteriorPlan(self.theta, 0.0, self.refusal, self.theta)
        self._evaluate(FOLLOWED_MAX)
        self._filter_on(FOLLOWED_MAX)
        if self._used > 0 and law.config.composite_gain > 0.0:
            self._filter.predict(since)
        X, S = self._filter.X_rows.T.copy(), self._filter.S.copy()
        if config.naive and law.theta.shape == theta.shape:
            X, S = np.vstack([law.W - theta, law.b]), law.state.S.copy()
        Phi, Phi_bar = old.evaluate(old.select(now)), self.new.evaluate(self.new.select(now))
        return _judged(config, law, theta, (X, S), Phi, Phi_bar)


def _judged(
    config: SwapConfig, law: KalmanLastLayer, theta: Array, found: tuple[Array, Array], Phi: Array, Phi_bar: Array
) -> PosteriorPlan:
    """The plan with X and S `found`: b takes up the jump here, and the one ahead is judged. Phi, Phi_bar: [k, NOW]."""
    (X, S), learns, limit = found, law.config.composite_gain > 0.0, law.config.weight_norm_max
    flying, new_nu = law.at(Phi), evaluate(law.config, theta, X, S, Phi_bar)
    law.look_ahead(new_nu)
    if learns:
        new_nu[:, 1] += new_nu[:, 0] - new_nu[:, 2]  # the gap is closed
    change = (new_nu - flying)[:, :2]
    if learns and not config.naive:
        X[-1] -= change[:, 0]
        change = change - change[:, [0]]
    here, commanded = (float(jump) for jump in np.sqrt((change * change).sum(axis=0)))
    if not (np.isfinite(here + commanded) and np.isfinite(S).all()):
        refusal = "not_finite"
    elif float(np.linalg.norm(X)) > limit:
        refusal = "weight_norm"
    else:
        refusal = "swap_jump" if commanded > config.jump_max else ""
    return PosteriorPlan(theta + X[:-1], max(here, commanded), refusal, theta, commanded, X, S)


def plan_posterior_swap(
    config: SwapConfig,
    law: KalmanLastLayer,
    old: Features,
    new: NetworkFeatures,
    limits: SlopeLimits,
    recent: RecentStates,
    now: Array,
    times: tuple[float, float, float],
) -> PosteriorPlan:
    """Plan the swap from `old` features with the state of `law` to `new` ones with their theta_n, all parts at once.

    Parameters
    ----------
    now: [SIGNAL_COUNT, NOW], the present state, the path ahead, and the path now.
    times: s, a tick, between two recent states, and from the newest one to the present.
    """
    swap = PosteriorSwap(config, law, new, limits, recent, now, times[:2])
    while not swap.step():
        pass
    return swap.plan(old, now, times[2])
