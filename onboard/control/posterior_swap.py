"""The swap of the law with a covariance: W, b and S in the new features are the posterior on the recent states.

Prior: W ~ N(theta, S0), b an Ornstein-Uhlenbeck process (sigma_b, s_b). Measured: the filtered residual y_i at the n
states of the last second,

    y_i = W'Phi_bar(x_i) + b(t_i) + v_i,    v_i ~ (0, R dt / (2 T))        T: time constant of the filter

so with the joint covariance of y and of [W; b] now,

    C = Phi_bar'S0 Phi_bar + sigma_b^2 exp(-s_b |t_i - t_j|) + R dt / (2 T) I
    M = [S0 Phi_bar; sigma_b^2 exp(-s_b (t - t_i))]
    [W - theta; b] = M C^-1 (y - Phi_bar'theta),    S = diag(S0, sigma_b^2) - M C^-1 M'.

This is the filter of the law, run over these states from its prior, but for the mean reversion of W within the second.
Then b takes up what is left of the jump of nu at the present state, so that nu is continuous there to rounding. eps_2,
the largest change of nu over the recent states and the present one, and of nu_cmd, is measured before anything changes.
A swap that would make nu_cmd jump by more than `jump_max` is refused. At a state of the past
second a large change is no jump: the vehicle is not there, and there the new map was fitted to what was measured. A
theta that is too steep for the loop is flattened first (onboard.control.slope).
"""

from dataclasses import dataclass, field

import numpy as np

from onboard.control.feature_swap import RecentStates, SwapConfig, SwapPlan
from onboard.control.features import Features
from onboard.control.laws.kalman_last_layer import KalmanLastLayer, evaluate, prior_variance
from onboard.control.slope import SlopeLimits, bounded_theta
from protocol.conventions import Array
from protocol.feature_set import ChannelFeatures


@dataclass(frozen=True, slots=True, eq=False)
class PosteriorPlan(SwapPlan):
    """The result of planning a swap of the law with a covariance."""

    X: Array = field(default_factory=lambda: np.zeros((0, 3)))
    """[k + 1, 3], [W - theta; b]."""
    S: Array = field(default_factory=lambda: np.zeros((0, 0)))
    """[k + 1, k + 1]."""


def plan_posterior_swap(
    config: SwapConfig,
    law: KalmanLastLayer,
    old: Features,
    new: Features,
    channel: ChannelFeatures,
    limits: SlopeLimits,
    recent: RecentStates,
    now: Array,
    times: tuple[float, float, float],
) -> PosteriorPlan:
    """Plan the swap from `old` features with the state of `law` to `new` ones with theta_n of `channel`.

    Parameters
    ----------
    now: [SIGNAL_COUNT, 3], the present state, the path ahead, and the path now.
    times: s, a tick, between two recent states, and from the newest one to the present.
    """
    k, limit, learns = channel.feature_count, law.config.weight_norm_max, law.config.composite_gain > 0.0
    signals, y = recent.in_order()
    states = np.hstack([signals, now])
    prior = prior_variance(law.config, k)
    if new.lipschitz > config.lipschitz_max:
        return _refused("lipschitz", channel.last_layer)
    if float(np.linalg.norm(channel.last_layer)) > limit:
        return _refused("weight_norm", channel.last_layer)
    Phi, Phi_bar = old.evaluate(old.select(states)), new.evaluate(new.select(states))
    theta, _ = bounded_theta(channel, limits, states, Phi_bar)
    if config.naive and law.theta.shape == theta.shape:
        X, S = np.vstack([law.W - theta, law.b]), law.state.S.copy()
    elif not learns:  # a law that is off flies the trained map
        X, S = np.zeros((k + 1, theta.shape[1])), np.diag(prior)
    else:
        X, S = posterior(law, prior, Phi_bar[:, :-3], y - Phi_bar[:, :-3].T @ theta, times)
    flying, new_nu = law.at(Phi), evaluate(law.config, theta, X, S, Phi_bar)
    if learns:
        new_nu[:, -2] += new_nu[:, -3] - new_nu[:, -1]  # the gap is closed
    change = (new_nu - flying)[:, :-1]
    if learns and not config.naive:
        X[-1] -= change[:, -2]
        change -= change[:, [-2]]
    jumps = np.sqrt((change * change).sum(axis=0))
    jump, commanded = float(jumps.max()), float(jumps[-1])
    W = theta + X[:-1]
    if not (np.isfinite(jump) and np.isfinite(S).all()):
        refusal = "not_finite"
    elif float(np.linalg.norm(X)) > limit:
        refusal = "weight_norm"
    else:
        refusal = "swap_jump" if commanded > config.jump_max else ""
    return PosteriorPlan(W, jump, refusal, theta, commanded, X, S)


def _refused(reason: str, theta: Array) -> PosteriorPlan:
    return PosteriorPlan(theta, 0.0, reason, theta)


def posterior(
    law: KalmanLastLayer, prior: Array, Phi: Array, y: Array, times: tuple[float, float, float]
) -> tuple[Array, Array]:
    """[W - theta; b] [k + 1, 3] and S [k + 1, k + 1] given the residuals about theta'Phi.

    Parameters
    ----------
    prior: [k + 1], diagonal of S0.
    Phi: [k, n], features of the states, the oldest first. y: [n, 3], residual minus theta'Phi.
    times: s, a tick, between two states, and from the newest one to the present.
    """
    n, (dt, between, since) = Phi.shape[1], times
    config = law.config
    if n == 0:
        return np.zeros((prior.size, y.shape[1])), np.diag(prior)
    age = between * np.arange(n - 1, -1, -1) + since
    noise = law.residual_variance(dt)
    weighted = prior[:-1, None] * Phi
    C = Phi.T @ weighted + prior[-1] * np.exp(-config.fast_bias_rate * np.abs(age[:, None] - age))
    C.flat[:: n + 1] += noise
    M = np.vstack([weighted, prior[-1] * np.exp(-config.fast_bias_rate * age)])
    L = np.linalg.cholesky(C)
    half = np.linalg.solve(L, np.hstack([M.T, y]))
    Z, rest = half[:, : prior.size], half[:, prior.size :]
    S = np.diag(prior) - Z.T @ Z
    return Z.T @ rest, 0.5 * (S + S.T)
