"""MRAC and DMRAC: nu_ad = W' Phi(x, c), with a last-layer law. In DMRAC the features are learnt in flight.

The law of the last layer is one of two, by configuration: the gradient law (`last_layer`), or the one with a covariance
(`kalman_last_layer`). They differ in how they learn, what they estimate, and how they swap.
"""

from dataclasses import dataclass
from math import exp, sqrt
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from configs.loader import ConfigRecord
from onboard.control.feature_swap import RecentStates, SwapConfig, SwapPlan, plan_swap
from onboard.control.features import BiasFeatures, Features, NetworkFeatures, RadialFeatures, random_channel, silenced
from onboard.control.laws.kalman_last_layer import KalmanConfig, KalmanLastLayer
from onboard.control.laws.last_layer import AdaptationConfig, LastLayer, lyapunov_p, tracking_weights
from onboard.control.laws.law import ChannelState
from onboard.control.laws.slope_bound import SlopeBound
from onboard.control.posterior_swap import PosteriorPlan, PosteriorSwap
from onboard.control.records import ChannelTelemetry
from onboard.control.reference_model import ChannelGains
from onboard.control.slope import SlopeLimits, SlopeShares
from protocol.conventions import Array
from protocol.feature_config import ChannelName, UntrainedFeatures
from protocol.feature_set import ChannelFeatures
from protocol.geometry import Vector3, vector
from protocol.signals import SIGNAL_COUNT

EPS_1_MEMORY_S = 2.0
"""Averaging time of eps_1, the misfit between W'Phi and Delta_hat."""


class AdaptiveConfig(ConfigRecord):
    """Adaptive augmentation of one channel."""

    kind: Literal["adaptive"]
    features: Literal["network", "rbf", "bias"]
    rbf_width: Annotated[float, Field(gt=0, description="width of the Gaussians, scaled units per sqrt(input)")] = 0.6
    law: Annotated[AdaptationConfig | KalmanConfig, Field(discriminator="kind")]
    error_weight: tuple[Annotated[float, Field(gt=0)], Annotated[float, Field(gt=0)]] = (1.0, 0.1)
    """Diagonal of Q: for the first and the second half of e."""
    swap: SwapConfig

    @property
    def slope_shares(self) -> SlopeShares:
        """Largest slope of a trained map. Law (2) reads its map at the vehicle: the loop's own gain."""
        return self.law.slope if isinstance(self.law, KalmanConfig) else SlopeShares(place=1.0, motion=1.0, turn=1.0)


def _start_features(
    config: AdaptiveConfig, inputs: UntrainedFeatures, channel: ChannelName, rng: np.random.Generator
) -> Features:
    """The features of a channel at the start of a flight."""
    if config.features == "bias":
        return BiasFeatures()
    names = inputs.inputs(channel)
    offset, scale = inputs.offset_and_scale(names)
    if config.features == "rbf":
        return RadialFeatures(names, offset, scale, config.rbf_width)
    start = random_channel(names, offset, scale, (*inputs.hidden, inputs.count - 1), rng)
    return NetworkFeatures(start if inputs.start == "random" else silenced(start))


@dataclass(frozen=True, slots=True, eq=False)
class Learnt:
    """The features of a channel and all that its law has learnt with them."""

    features: Features
    theta: Array
    """[k, 3], the trained last layer."""
    W: Array
    """[k, 3]; law (2a): X = [W - theta; b], [k + 1, 3]."""
    S: Array | None
    """[k + 1, k + 1], law (2a) only."""


class AdaptiveAugmentation:
    """One channel's features, last layer, and swap."""

    def __init__(
        self,
        config: AdaptiveConfig,
        gains: ChannelGains,
        inputs: UntrainedFeatures,
        channel: ChannelName,
        rng: np.random.Generator,
        slope_limits: SlopeLimits,
    ) -> None:
        """inputs: what the start features and the radial basis functions see; the bias alone sees nothing."""
        self._config, self.slope_limits = config, slope_limits
        A_rm = gains.closed_loop_matrix()
        Q = np.diag(np.repeat(config.error_weight, 3))
        P = lyapunov_p(A_rm, Q)
        features = _start_features(config, inputs, channel, rng)
        PB, k = tracking_weights(P, gains.natural_frequency_rad_s), features.feature_count
        self.tracking_weights = PB
        """[6, 3], of e in the tracking term."""
        self.last_layer: LastLayer | KalmanLastLayer = (
            KalmanLastLayer(config.law, k, PB, gains.pairs())
            if isinstance(config.law, KalmanConfig)
            else LastLayer(config.law, k, PB)
        )
        self._slope_bound: SlopeBound | None = None
        self._use(features)
        self._filter_s, self._ring_period = config.law.residual_filter_s, config.swap.ring_period_ticks
        self._recent = RecentStates(config.swap.ring_size, SIGNAL_COUNT)
        self._signals: Array = np.zeros((SIGNAL_COUNT, 3 if self.reads_path else 2))
        self._ticks, self._dt = 0, 0.0
        self._Delta_hat: Vector3 = (0.0, 0.0, 0.0)
        self._eps_1_squared = 0.0
        self._eps_2 = 0.0

    @property
    def reads_path(self) -> bool:
        """Whether the map is read on the path ahead, and not at x_ahead."""
        return isinstance(self.last_layer, KalmanLastLayer)

    def step(self, channel: ChannelState, telemetry: ChannelTelemetry) -> Array:
        """Update W with Phi(x); returns nu_cmd, [3]."""
        dt = channel.dt
        self._signals = channel.signals
        Phi = self.features.evaluate(self.features.select(channel.signals))
        if channel.adapt:
            self._filter_residual(channel.residual.tolist(), dt)
            if self._slope_bound is not None:
                assert isinstance(self.last_layer, KalmanLastLayer)
                self._slope_bound.step(self.features, self.last_layer.state)
            nu = self.last_layer.learn(Phi, channel, self._Delta_hat)
            if self._ticks % self._ring_period == 0:
                self._recent.push(channel.signals[:, 0], self._Delta_hat)
            self._ticks += 1
        else:
            nu = self.last_layer.estimate(Phi)
        self._dt = dt
        self._report(nu, dt, telemetry)
        return nu[:, 1]

    def _use(self, features: Features) -> None:
        """Fly these features."""
        self.features, law = features, self.last_layer.config
        if isinstance(law, KalmanConfig) and law.composite_gain > 0.0:
            ticks = 0 if self._slope_bound is None else self._slope_bound.ticks
            self._slope_bound = SlopeBound(features.inputs, self.slope_limits, ticks)

    def _filter_residual(self, residual: list[float], dt: float) -> None:
        """Delta_hat_dot = (r - Delta_hat) / T, exact for a residual r that is constant over dt."""
        share = 1.0 - exp(-dt / self._filter_s)
        self._Delta_hat = vector(D + share * (r - D) for D, r in zip(self._Delta_hat, residual, strict=True))

    def _report(self, nu: Array, dt: float, telemetry: ChannelTelemetry) -> None:
        """eps_1: mean of norm(nu(x) - Delta_hat); eps_3: norm(nu_cmd - nu(x))."""
        now, ahead = nu.T.tolist()
        misfit2 = sum((nu_i - D) ** 2 for nu_i, D in zip(now, self._Delta_hat, strict=True))
        self._eps_1_squared += min(dt / EPS_1_MEMORY_S, 1.0) * (misfit2 - self._eps_1_squared)
        telemetry.adaptive_now[:] = now
        telemetry.residual[:] = self._Delta_hat
        telemetry.weight_norm = self.last_layer.weight_norm
        telemetry.eps_1, telemetry.eps_2 = sqrt(self._eps_1_squared), self._eps_2
        telemetry.eps_3 = sqrt(sum((there - here) ** 2 for there, here in zip(ahead, now, strict=True)))

    def reset(self) -> None:
        """Reset the filters. W and the features stay."""
        self._Delta_hat = (0.0, 0.0, 0.0)
        if isinstance(self.last_layer, KalmanLastLayer):
            self.last_layer.close_gap()

    @property
    def learns(self) -> bool:
        """Whether the features may be replaced by trained ones."""
        return self._config.features == "network"

    @property
    def jump_max(self) -> float:
        """Largest jump of a swap, units of u."""
        return self._config.swap.jump_max

    @property
    def signals_now(self) -> Array:
        """[SIGNAL_COUNT], of the last tick."""
        return self._signals[:, 0]

    @property
    def recent(self) -> tuple[Array, Array]:
        """Signals [SIGNAL_COUNT, n] and residuals [n, 3] of the last second, the oldest first."""
        return self._recent.in_order()

    @property
    def prior_layer(self) -> Array:
        """[k, 3], what the map flies with where nothing was measured: theta of law (2a), W of law (2)."""
        law = self.last_layer
        return law.theta if isinstance(law, KalmanLastLayer) else law.W

    @staticmethod
    def prior_of(plan: SwapPlan) -> Array:
        """The same after a swap."""
        return plan.theta if isinstance(plan, PosteriorPlan) else plan.W

    def learnt(self) -> Learnt:
        """A copy of everything that a swap replaces."""
        law = self.last_layer
        if isinstance(law, KalmanLastLayer):
            return Learnt(self.features, law.theta.copy(), law.state.X_rows.T.copy(), law.state.S.copy())
        return Learnt(self.features, law.memory.copy(), law.W.copy(), None)

    def restore(self, learnt: Learnt, nu: Vector3) -> None:
        """Fly these features and this W again; the bias takes up what is missing to nu at the present state."""
        self._use(learnt.features)
        law = self.last_layer
        W = learnt.W.copy()
        if isinstance(law, KalmanLastLayer):
            assert learnt.S is not None
            law.adopt(learnt.theta, W, learnt.S)
        else:
            law.replace(W, learnt.theta)
        Phi = self.features.evaluate(self.features.select(self._signals))
        W[-1] += np.array(nu) - law.estimate(Phi)[:, 0]
        if isinstance(law, KalmanLastLayer):
            law.adopt(learnt.theta, W, law.state.S.copy())
            law.close_gap(Phi)
        else:
            law.replace(W, learnt.theta)
        self._eps_2 = 0.0

    def flies(self, channel: ChannelFeatures) -> bool:
        """Whether these features, with this theta, are in use already."""
        return isinstance(self.features, NetworkFeatures) and self.features.channel.same_as(channel)

    def prepare(self, channel: ChannelFeatures) -> PosteriorSwap | None:
        """Start to prepare a swap to these features (law (2a)); None for law (2), whose plan needs no preparation."""
        law = self.last_layer
        if not isinstance(law, KalmanLastLayer):
            return None
        times = self._dt, self._ring_period * self._dt
        new = NetworkFeatures(channel)
        return PosteriorSwap(self._config.swap, law, new, self.slope_limits, self._recent, self._signals, times)

    def planned(self, swap: PosteriorSwap) -> SwapPlan:
        """The plan of a swap that is prepared; nothing changes yet."""
        since = self._ticks - 1 - (swap.seen - 1) * self._ring_period
        return swap.plan(self.features, self._signals, since * self._dt)

    def plan(self, channel: ChannelFeatures) -> tuple[Features, SwapPlan]:
        """Plan a swap to these features, all parts at once; nothing changes yet."""
        swap = self.prepare(channel)
        if swap is not None:
            while not swap.step():
                pass
            return swap.new, self.planned(swap)
        assert isinstance(self.last_layer, LastLayer)
        new, law, config = NetworkFeatures(channel), self.last_layer, self._config
        recent, limit = self._recent.columns(self._signals), config.law.weight_norm_max
        return new, plan_swap(config.swap, self.features, law.W, new, channel.last_layer, limit, recent)

    def commit(self, features: Features, plan: SwapPlan) -> None:
        """Carry out a plan that was not refused."""
        self._use(features)
        if isinstance(self.last_layer, KalmanLastLayer):
            assert isinstance(plan, PosteriorPlan)
            self.last_layer.adopt(plan.theta, plan.X, plan.S)
            self.last_layer.close_gap(features.evaluate(features.select(self._signals)))
        else:
            self.last_layer.replace(plan.W, plan.theta)
        self._eps_2 = plan.jump
