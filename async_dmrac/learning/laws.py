"""The laws of a learner's last layer, and the protocol of a law of one's own.

Both laws of the flight are here as they fly (onboard.control.laws), for any number of outputs. Outputs and residuals
are in units of their usual size (`Learner.output_scales`), so that one setting fits all outputs.
"""

from typing import Protocol, runtime_checkable

import numpy as np

from onboard.control.feature_swap import RecentStates, SwapConfig, SwapPlan, bumpless_last_layer, plan_swap
from onboard.control.features import Features, NetworkFeatures
from onboard.control.laws.kalman_last_layer import KalmanConfig, KalmanLastLayer
from onboard.control.laws.last_layer import AdaptationConfig, LastLayer
from onboard.control.posterior_swap import plan_posterior_swap
from onboard.control.slope import SlopeLimits
from protocol.conventions import Array

NO_LIMITS = SlopeLimits(())
FASTEST_SHARE = 0.3
"""Of the residual that the default laws take up in one tick, at most."""


class Law(Protocol):
    """A law of the last layer W [k, q]: k features (the last one is the constant 1), q outputs."""

    def start(self, theta: Array, dt: float, PB: Array) -> None:
        """Begin with new features and their trained last layer theta [k, q].

        Parameters
        ----------
        dt: s between two updates. PB: [2 q, q], weights of the tracking error e; zero without one.
        """

    def update(self, Phi: Array, residual: Array, error: Array) -> None:
        """One tick: features Phi [k], measured residual [q], tracking error e = x_rm - x [2 q], zero without one."""

    def estimate(self, Phi: Array) -> Array:
        """The estimate [q, n] at the features Phi [k, n]."""


@runtime_checkable
class SwappingLaw(Protocol):
    """A law with a swap of its own. Any other law starts at the W that continues its estimate (`swap`)."""

    def swap(
        self, config: SwapConfig, old: Features, new: NetworkFeatures, recent: RecentStates, now: Array
    ) -> SwapPlan:
        """Plan the swap to `new` features, and carry it out unless the plan has a refusal.

        Parameters
        ----------
        now: [m], the present signals.
        """


class KalmanLaw:
    """The law with a covariance: W and a fast bias, estimated together (onboard.control.laws.kalman_last_layer)."""

    def __init__(self, config: KalmanConfig | None = None) -> None:
        """config: None: values for residuals of usual size 1, as fast as the rate of the updates allows."""
        self._given = config

    def start(self, theta: Array, dt: float, PB: Array) -> None:
        """Begin with W = theta, b = 0 and S = S0."""
        config = self._given or _kalman(FASTEST_SHARE / dt, bool(PB.any()))
        self._dt = dt
        without_path = [(0.0, 0.0)] * theta.shape[1]  # the map is read at one place only: there is no gap
        self.law = KalmanLastLayer(config, theta.shape[0], PB, without_path)
        self.law.replace(theta, theta)

    def update(self, Phi: Array, residual: Array, error: Array) -> None:
        """Predict and correct."""
        self.law.step(np.repeat(Phi[:, None], 3, axis=1), error, residual.tolist(), self._dt)

    def estimate(self, Phi: Array) -> Array:
        """W'Phi + b."""
        nu: Array = self.law.W.T @ Phi + self.law.b[:, None]
        return nu

    def swap(
        self, config: SwapConfig, old: Features, new: NetworkFeatures, recent: RecentStates, now: Array
    ) -> SwapPlan:
        """W, b and S become the posterior on the recent states."""
        states, between = np.repeat(now[:, None], 3, axis=1), config.ring_period_ticks * self._dt
        times = self._dt, between, 0.5 * between
        plan = plan_posterior_swap(config, self.law, old, new, NO_LIMITS, recent, states, times)
        if not plan.refusal:
            self.law.adopt(plan.theta, plan.X, plan.S)
            self.law.close_gap(new.evaluate(new.select(states)))
        return plan


class GradientLaw:
    """The gradient law with projection (onboard.control.laws.last_layer). It has no covariance."""

    def __init__(self, config: AdaptationConfig | None = None) -> None:
        """config: None: values for residuals of usual size 1, as fast as the rate of the updates allows."""
        self._given = config

    def start(self, theta: Array, dt: float, PB: Array) -> None:
        """Begin with W = theta, which is also what W leaks towards."""
        self._dt = dt
        self.law = LastLayer(self._given or _gradient(FASTEST_SHARE / dt, bool(PB.any())), theta.shape[0], PB)
        self.law.replace(theta, theta)

    def update(self, Phi: Array, residual: Array, error: Array) -> None:
        """One step of W_dot."""
        self.law.step(Phi, error, residual.tolist(), self._dt)

    def estimate(self, Phi: Array) -> Array:
        """W'Phi."""
        return self.law.estimate(Phi)

    def swap(
        self, config: SwapConfig, old: Features, new: NetworkFeatures, recent: RecentStates, now: Array
    ) -> SwapPlan:
        """W becomes the one that keeps W'Phi at the recent states, between theta and the W of before elsewhere."""
        states, limit = recent.columns(now[:, None]), self.law.config.weight_norm_max
        plan = plan_swap(config, old, self.law.W, new, new.channel.last_layer, limit, states)
        if not plan.refusal:
            self.law.replace(plan.W, plan.theta)
        return plan


def swap(
    law: Law,
    config: SwapConfig,
    old: Features,
    new: NetworkFeatures,
    recent: RecentStates,
    now: Array,
    dt: float,
    PB: Array,
) -> SwapPlan:
    """Carry out the swap of a law that has none of its own, as `GradientLaw` without resemblance; or refuse it."""
    if isinstance(law, SwappingLaw):
        return law.swap(config, old, new, recent, now)
    theta, states = new.channel.last_layer, recent.columns(now[:, None])
    before = law.estimate(old.evaluate(old.select(states)))
    Phi = new.evaluate(new.select(states))
    W = bumpless_last_layer(Phi, before, theta, config.memory_weight * states.shape[1])
    jump = float(np.linalg.norm(W.T @ Phi - before, axis=0).max())
    refusal = "" if jump <= config.jump_max else "swap_jump"
    if not refusal:
        law.start(W, dt, PB)
    return SwapPlan(W, jump, refusal, theta)


def _kalman(fastest_1_s: float, tracks: bool) -> KalmanConfig:
    return KalmanConfig(
        kind="kalman",
        tracking_gain=3.0 if tracks else 0.0,
        composite_gain=min(fastest_1_s, 60.0),
        noise=0.3,
        prior=0.5,
        fast_bias=0.5,
        prior_rate=0.03,
        fast_bias_rate=2.0,
        weight_norm_max=100.0,
    )


def _gradient(fastest_1_s: float, tracks: bool) -> AdaptationConfig:
    return AdaptationConfig(
        tracking_gain=3.0 if tracks else 0.0,
        composite_gain=min(fastest_1_s, 60.0),
        bias_weight=20.0,
        leak=0.0,
        weight_norm_max=100.0,
    )
