"""The last-layer law with a covariance: W and a fast bias b are estimated together by a Kalman filter.

    Delta = W'Phi + b + v,    v ~ (0, R) in each tick
    W_dot = -s_w (W - theta) + noise,    b_dot = -s_b b + noise          stationary: S0 = diag(p^2, ..., sigma_b^2)
    nu     = W'Phi + b                                                   at the present state x
    nu_cmd = W'Phi_p + g (theta'Phi_a + a (W - theta)'Phi_a - W'Phi_p) + b + gap      a: on the path, t_ahead from now
    gap: what the map says at x, W'Phi - W'Phi_p, behind a filter        p: on the path, now

theta is the trained last layer, the prior of W. A tick first predicts (W, b and S decay to theta, 0 and S0), then
corrects with the filtered residual r, phi = [Phi; 1] and s = phi'S phi:

    [W; b] += S phi (r - nu - t e'PB)' / (R_t + s),    S -= S phi phi'S / (R_t + s),    R_t = max(R, s / (lambda dt))

- Composite and tracking term in one: Gamma = S / R_t. t is tracking_gain / lambda, so the tracking term moves nu by at
  most tracking_gain per second and unit of e_1, as in the gradient law.
- R_t bounds the bandwidth of the loop: nu follows the residual at no more than lambda, whatever S0, R and Phi are. It
  is the noise with which that rate is optimal.
- [W - theta; b] stays in a ball, by projection in the metric of S^-1.
- The map is read on the path, so it is no feedback. gap is what it says at x beside the path, behind the filter by
  which the law itself takes up a misfit (onboard/control/laws/path_gap.py): the loop has about the margins of the bias
  alone, whatever the slope of the map. Where the map is right, x is answered as by the map itself, that late.
- Skill: g is the share of the map's changes that came true (onboard/control/laws/forecast_skill.py), in each axis.
- Confidence: c(x) = 1 - Phi'S Phi / Phi'S0 Phi is the share of the prior's variance that is explained at x. a =
  c(x_a) / c(x), at most 1: where less was measured than here, nu_cmd fades to theta'Phi_a + b instead of
  extrapolating. At the present state nothing has to fade: the residual corrects nu there, at the full lambda where S is
  large.

Stability, what is proven and what is measured: docs/theory_covariance.md.
"""

import math
from collections.abc import Sequence
from typing import Annotated, Final, Literal

import numpy as np
from pydantic import Field

from configs.loader import ConfigRecord
from onboard.control.laws.forecast_skill import ForecastSkill
from onboard.control.laws.kalman_state import KalmanState, multiplier
from onboard.control.laws.last_layer import SQUARE_MAX, tracking_rate_weight
from onboard.control.laws.law import ChannelState
from onboard.control.laws.path_gap import PathGap
from onboard.control.slope import SlopeShares
from protocol.conventions import Array
from protocol.geometry import Vector3

UPDATED: Final = np.array([1.0, 0.0, 0.0, 1.0])
"""phi = [Phi; 1], of the four columns."""


class KalmanConfig(ConfigRecord):
    """Settings of one channel's last-layer law with a covariance."""

    kind: Literal["kalman"]
    tracking_gain: Annotated[
        float, Field(ge=0, le=1e4, description="1/s^3: nu_ad gains at most so much per second and unit of e_1")
    ]
    composite_gain: Annotated[
        float, Field(ge=0, le=1e3, description="lambda, 1/s: nu_ad follows the residual no faster than this; 0 = off")
    ]
    noise: Annotated[float, Field(gt=0, le=1e3, description="sqrt(R): residual of a tick about the model, units of u")]
    prior: Annotated[float, Field(gt=0, le=1e3, description="p: spread of W about the trained last layer, units of u")]
    fast_bias: Annotated[float, Field(gt=0, le=1e3, description="sigma_b: stationary spread of b, units of u")]
    prior_rate: Annotated[float, Field(ge=0.003, le=10, description="s_w, 1/s: W reverts to the trained last layer")]
    fast_bias_rate: Annotated[float, Field(ge=0.003, le=50, description="s_b, 1/s: b reverts to zero")]
    weight_norm_max: Annotated[
        float, Field(gt=0, description="W_max: radius of the balls of theta and of [W - theta; b]")
    ]
    residual_filter_s: Annotated[float, Field(ge=0.001, le=1, description="time constant of Delta_hat")] = 0.02
    confidence: Annotated[bool, Field(description="false: ablation, a = 1")] = True
    skill: Annotated[bool, Field(description="false: ablation, g = 1")] = True
    slope: SlopeShares = SlopeShares()


class KalmanLastLayer:
    """W, b and S of one channel, and their law. The state is X = [W - theta; b]."""

    def __init__(
        self, config: KalmanConfig, feature_count: int, PB: Array, gains: Sequence[tuple[float, float]]
    ) -> None:
        """Take the weights and the gains of the channel's reference model.

        PB: [n, q], from its Lyapunov equation (tracking_weights). gains: (K_1, K_2) of each of the q outputs. There are
        3 in a channel of the vehicle; where this file says 3, q is meant.
        """
        self.config = config
        self._PB = PB
        self._rate_weight = tracking_rate_weight(PB)
        self._noise_variance, self._prior_variance = config.noise**2, config.prior**2
        self._radius2 = config.weight_norm_max**2
        self._gap = PathGap(PB, gains)
        self._skill = ForecastSkill(self._noise_variance, PB.shape[1])
        if not config.skill or config.composite_gain == 0.0:
            self._skill.shares = [1.0] * PB.shape[1]
        self._start(np.zeros((feature_count, PB.shape[1])))

    def _start(self, theta: Array) -> None:
        """X = 0 and S = S0 with this theta [k, 3]."""
        k, config = theta.shape[0], self.config
        rates = np.full(k + 1, config.prior_rate)
        rates[-1] = config.fast_bias_rate
        self.state = KalmanState(np.vstack([theta, np.zeros(theta.shape[1])]), prior_variance(config, k), rates)
        self._theta_norm2 = float(np.vdot(theta, theta))
        self._columns: Array = np.zeros((k + 1, 4))
        """[Phi; 0], [Phi_a; 0], [Phi_p; 0], [0; 1]."""
        self._columns[-1, 3] = 1.0
        self._Phi = self._columns[:-1, :3]
        self._X_norm2 = 0.0
        self._gap.close()
        self._skill.restart()

    # --- what others see -------------------------------------------------------------------------------------------

    @property
    def theta(self) -> Array:
        """[k, 3], the trained last layer."""
        return self.state.theta_rows[:, :-1].T

    @property
    def W(self) -> Array:
        """[k, 3], a copy."""
        W: Array = (self.state.theta_rows + self.state.X_rows)[:, :-1].T
        return W

    @property
    def b(self) -> Array:
        """[3], the fast bias, a copy."""
        return self.state.X_rows[:, -1].copy()

    @property
    def weight_norm(self) -> float:
        """Frobenius norm of W, units of u."""
        of_b = sum(b * b for b in self.state.X_rows[:, -1].tolist())
        cross = 2.0 * float(np.vdot(self.state.theta_rows, self.state.X_rows))
        return math.sqrt(max(self._theta_norm2 + cross + self._X_norm2 - of_b, 0.0))

    def residual_variance(self, dt: float) -> float:
        """Variance of what R makes of Delta_hat: white noise behind the filter."""
        return self._noise_variance * dt / (2.0 * self.config.residual_filter_s)

    def replace(self, W: Array, theta: Array) -> None:
        """Take over W [k, 3] and theta [k, 3] that belong to new features, with S = S0 and b = 0."""
        self._start(theta)
        self.state.X_rows[:, :-1] = (W - theta).T
        self._keep_in_ball()

    def adopt(self, theta: Array, X: Array, S: Array) -> None:
        """Take over theta [k, 3], X = [W - theta; b] [k + 1, 3] and S [k + 1, k + 1] that belong to new features."""
        self._start(theta)
        self.state.X_rows[:], self.state.S[:] = X.T, S
        self._keep_in_ball()

    def estimate(self, Phi: Array) -> Array:
        """nu and nu_cmd, [3, 2]. Phi [k, 3]: features at the present state, on the path ahead, and on the path now."""
        return self.at(Phi)[:, :2]

    def at(self, Phi: Array) -> Array:
        """nu [3, n] at the features Phi [k, n]. The last three are those of `estimate`: the second is nu_cmd."""
        nu = evaluate(self.config, self.theta, self.state.X_rows.T, self.state.S, Phi)
        self.look_ahead(nu)
        nu[:, -2] += self._gap.values
        return nu

    def look_ahead(self, nu: Array) -> None:
        """Leave of the change ahead, nu[:, -2] - nu[:, -1], the share that the skill allows."""
        nu[:, -2] = nu[:, -1] + self._skill.shares * (nu[:, -2] - nu[:, -1])

    def close_gap(self, Phi: Array | None = None) -> None:
        """The deviation from the path counts in full: after a swap. Phi as in `estimate`; None: there is none.

        A law that is off takes up no misfit, so there the map is read on the path alone.
        """
        self._gap.close()
        if Phi is not None and self.config.composite_gain > 0.0:
            nu = evaluate(self.config, self.theta, self.state.X_rows.T, self.state.S, Phi)
            self._gap.close((nu[:, 0] - nu[:, 2]).tolist())

    # --- the law ---------------------------------------------------------------------------------------------------

    def learn(self, Phi: Array, channel: ChannelState, Delta_hat: Vector3) -> Array:
        """One tick of the law; returns nu and nu_cmd, [3, 2]. Phi as in `estimate`.

        The law takes the filtered residual, as the gradient law does. At lambda dt = 0.2 the noise of single ticks
        would come through, to motors that are driven against their lag.
        """
        return self.step(Phi, channel.model_error, list(Delta_hat), channel.dt)

    def step(self, Phi: Array, e: Array, residual: list[float], dt: float) -> Array:
        """Predict, correct, project; returns nu and nu_cmd, [3, 2]. Phi as in `estimate`.

        Parameters
        ----------
        e: [n], x_rm - x; the second half is the rate of the first.
        residual: [3], Delta_hat, units of u.
        dt: s.
        """
        config, state, columns = self.config, self.state, self._columns
        if config.composite_gain == 0.0:
            return self.estimate(Phi)
        state.predict(dt)
        self._Phi[:] = Phi
        product, q = state.along(columns), state.outputs
        G = product[2 * q :]
        # Quadratic forms of S along Phi (h, here), Phi ahead (a), Phi on the path now (p) and the bias (b).
        (hh, _, _, _), (ah, aa, _, _), (ph, _, _, _), (bh, ba, bp, bb) = columns.T.dot(G).tolist()
        s = hh + 2.0 * bh + bb
        v = max(self._noise_variance, s / (config.composite_gain * dt)) + s
        along = product[: 2 * q].tolist()
        of_theta, of_X = along[:q], along[q:]
        share = s / v
        t = self._tracking(share, dt)
        each_axis = zip(residual, of_theta, of_X, e.dot(self._PB).tolist(), strict=True)
        innovation = [r - th[0] - X[0] - X[3] - t * ePB for r, th, X, ePB in each_axis]
        if not (0.0 < s < SQUARE_MAX and sum(d * d for d in innovation) < SQUARE_MAX):  # NaN fails too
            self._X_norm2 = float(np.vdot(state.X_rows, state.X_rows))
            return self.estimate(Phi)
        if config.skill:
            self._skill.step(residual, [th[0] + X[0] for th, X in zip(of_theta, of_X, strict=True)], dt)
        state.correct(G.dot(UPDATED), innovation, v)
        self._X_norm2 = float(np.vdot(state.X_rows, state.X_rows))
        if self._X_norm2 > self._radius2:
            self._keep_in_ball()
            return self.estimate(Phi)
        # What the correction changed along each column, without another product.
        here, ahead, path, bias = (hh + bh) / v, (ah + ba) / v, (ph + bp) / v, (bh + bb) / v
        a = 1.0
        if config.confidence:
            of_here, of_ahead = np.square(columns[:, :2]).sum(axis=0).tolist()
            p2 = self._prior_variance
            a = fade(1.0 - (hh - here * here * v) / (p2 * of_here), 1.0 - (aa - ahead * ahead * v) / (p2 * of_ahead))
        corrected = zip(of_theta, of_X, innovation, strict=True)
        maps = [(th[0] + X[0] + here * d, th[2] + X[2] + path * d) for th, X, d in corrected]
        keep = 1.0 - config.fast_bias_rate * dt * (bh + bb) / s
        self._gap.step([map_here - on_path for map_here, on_path in maps], share, keep, t, dt)
        nu = []
        for th, X, d, (map_here, on_path), g, gap in zip(
            of_theta, of_X, innovation, maps, self._skill.shares, self._gap.values, strict=True
        ):
            b, change = X[3] + bias * d, th[1] + a * (X[1] + ahead * d) - on_path
            nu.append((map_here + b, on_path + g * change + b + gap))
        return np.array(nu)

    def _tracking(self, share: float, dt: float) -> float:
        """Factor of e'PB in the innovation, implicit in the effect of the tracking term on e_2 one tick later."""
        t = self.config.tracking_gain / self.config.composite_gain
        return t / (1.0 + share * t * self._rate_weight * dt)

    def _keep_in_ball(self) -> None:
        """Project X onto its ball; scale what rounding leaves outside."""
        X_rows = self.state.X_rows
        X_rows[:] = project(X_rows, self.state.S, self.config.weight_norm_max)
        self._X_norm2 = float(np.vdot(X_rows, X_rows))
        if self._X_norm2 > self._radius2:
            X_rows *= (self._radius2 / self._X_norm2) ** 0.5
            self._X_norm2 = self._radius2


def prior_variance(config: KalmanConfig, feature_count: int) -> Array:
    """[k + 1], the diagonal of S0."""
    variance = np.full(feature_count + 1, config.prior**2)
    variance[-1] = config.fast_bias**2
    return variance


def evaluate(config: KalmanConfig, theta: Array, X: Array, S: Array, Phi: Array) -> Array:
    """nu [3, n] at the features Phi [k, n]. The last three are those of the law: the second of them, ahead, fades."""
    of_X = X[:-1].T @ Phi
    if config.confidence:
        of_X[:, -2] *= fade(*confidence(S, prior_variance(config, theta.shape[0]), Phi[:, -3:-1]).tolist())
    nu: Array = theta.T @ Phi + of_X + X[-1][:, None]
    return nu


def confidence(S: Array, variance: Array, Phi: Array) -> Array:
    """c = 1 - Phi'S Phi / Phi'S0 Phi, [n], at the features Phi [k, n]; S is [k + 1, k + 1] with the bias last."""
    unknown = (Phi * (S[:-1, :-1] @ Phi)).sum(axis=0)
    c: Array = 1.0 - unknown / (variance[:-1, None] * Phi * Phi).sum(axis=0)
    return c


def fade(here: float, ahead: float) -> float:
    """a, from the confidence at the present state and at the one ahead."""
    return max(ahead, 0.0) / here if ahead < here and here > 0.0 else 1.0


def project(X_rows: Array, S: Array, radius: float) -> Array:
    """X' [3, n] projected onto the ball norm(X) <= radius in the metric of S^-1, so that V never grows by it.

    The nearest X in that metric is (I + mu S)^-1 X with the mu >= 0 that makes its norm the radius. In the axes of S
    each component shrinks by 1 / (1 + mu s_j).
    """
    if not float(np.vdot(X_rows, X_rows)) > radius * radius:
        return X_rows
    s, axes = np.linalg.eigh(S)
    along = X_rows @ axes
    mu = multiplier((along * along).sum(axis=0), s, radius)
    projected: Array = (along / (1.0 + mu * s)) @ axes.T
    return projected
