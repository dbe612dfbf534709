"""The last-layer adaptive law: updates W at 200 Hz so that nu_ad = W' Phi follows the disturbance Delta.

Theory of operation
-------------------
The model error e = x_rm - x of the hedged reference model obeys e_dot = A_rm e + B (nu_ad - Delta). The law is

    W_dot = Proj(W, -Gamma Phi (gamma e' P B + lambda (W'Phi - Delta_hat)') / m^2) - sigma L (W - theta_n)
    m^2 = eps + Phi' Gamma Phi,  Gamma = diag(1, ..., 1, kappa),  L = diag(1, ..., 1, 0)

with a tracking term (gamma), a composite term (lambda) and a leak (sigma) towards the trained last layer theta_n; the
bias has no leak. The sign of the tracking term follows from e = x_rm - x and u = ... - nu_ad. Joshi, Virdi, Chowdhary
2020 print the opposite sign, with which V grows.

Stability, in continuous time. With Delta = W*' Phi, constant W* in the ball, Delta_hat = Delta, W~ = W - W*, no leak
and any constant c > 0, V = e'P e + (c / gamma) tr(W~' Gamma^-1 W~) obeys

    V_dot <= -e'Q e + 2 (1 - c / m^2) e'P B W~'Phi - 2 c lambda / (gamma m^2) |W~'Phi|^2.

Dividing by m^2 leaves the cross term, which vanishes only if m^2 is constant (bias alone, c = m^2). With
c = m_min m_max and rho = m_max / m_min the composite term dominates it, and V never grows, if

    lambda >= gamma norm(B'P Q^-1 P B) (rho - 1)^2 / (2 rho).

The weight of the bias, kappa, keeps rho near 1. A test checks the condition for every shipped controller with a
composite term; lambda = 0 violates it unless rho = 1. With leak, or with errors in Delta_hat or in the features, e is
ultimately bounded instead. docs/theory.md has the derivations and what is not proven.

As computed. Both terms are implicit: the composite term in W'Phi, the tracking term in its effect on e_2 one step
later. Without projection and leak, one step equals W+ = W + dt W_dot of the law above with

    gamma / (1 + gamma p dt^2) for gamma,  p the largest weight of e_2 in PB,
    eps + (1 + lambda dt) Phi' Gamma Phi for m^2,

so the composite term never overshoots Delta_hat, the tracking gain stays below 1 / (p dt^2), and the condition on
lambda still holds. The leak is implicit as well. The smooth projection acts on the step before the leak; afterwards a
safeguard scales W back to norm(W) <= W_max sqrt(1 + PROJECTION_MARGIN). A step that is not finite is skipped.
"""

import math
from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from configs.loader import ConfigRecord
from onboard.control.laws.law import ChannelState
from protocol.conventions import Array
from protocol.geometry import Vector3

PROJECTION_MARGIN = 0.1
"""eps of the projection operator: the square of the norm may exceed W_max^2 by this share."""
SQUARE_MAX = 1e30
"""No square of a sensible number is this large; a step with larger ones, or with NaN, is left out."""


class AdaptationConfig(ConfigRecord):
    """Gains of one channel's last-layer law."""

    kind: Literal["gradient"] = "gradient"
    tracking_gain: Annotated[
        float,
        Field(ge=0, le=1e4, description="gamma, 1/s^3: nu_ad gains so much per second and unit of e_1, first axis"),
    ]
    composite_gain: Annotated[
        float, Field(ge=0, le=1e3, description="lambda, 1/s: nu_ad approaches Delta_hat; 0 = off")
    ]
    bias_weight: Annotated[float, Field(gt=0, le=1e4, description="kappa: Gamma of the bias against the others")]
    leak: Annotated[
        float, Field(ge=0, le=10, description="sigma, 1/s: W, the bias apart, drifts back to the trained last layer")
    ]
    weight_norm_max: Annotated[float, Field(gt=0, description="W_max: radius of the ball W is kept in, units of u")]
    normalisation_floor: Annotated[float, Field(gt=0, description="eps in eps + Phi'Gamma Phi")] = 1e-3
    residual_filter_s: Annotated[float, Field(ge=0.005, le=1, description="time constant of Delta_hat")] = 0.03


def lyapunov_p(A_rm: Array, Q: Array) -> Array:
    """P of A_rm' P + P A_rm + Q = 0, symmetric.

    Parameters
    ----------
    A_rm: [n, n], Hurwitz.
    Q: [n, n], symmetric positive definite.

    Raises
    ------
    ValueError
        If the solution is not positive definite, that is, if A_rm is not Hurwitz.
    """
    n = A_rm.shape[0]
    eye = np.eye(n)
    operator = np.kron(eye, A_rm.T) + np.kron(A_rm.T, eye)
    P = np.linalg.solve(operator, -Q.reshape(-1)).reshape(n, n)
    P = 0.5 * (P + P.T)
    if float(np.linalg.eigvalsh(P)[0]) <= 0.0:
        raise ValueError("no positive definite P: the reference model is not Hurwitz")
    return P


def tracking_weights(P: Array, natural_frequency_rad_s: Sequence[float]) -> Array:
    """PB [2 q, q] as the law uses it, each axis scaled so that gamma means the same whatever Q: an integral gain.

    The axes of a channel are decoupled, so scaling an axis' column scales its part of P and of Q alike and leaves the
    Lyapunov equation true. The weight of e_1 becomes 1 in the first axis and (omega_n / omega_n1)^3 in the others: that
    gives each its gain in proportion to its bandwidth.
    """
    axes = P.shape[0] // 2
    PB = P[:, axes:].copy()
    for axis, omega_n in enumerate(natural_frequency_rad_s):
        PB[:, axis] *= (omega_n / natural_frequency_rad_s[0]) ** 3 / P[axis, axes + axis]
    return PB


def tracking_rate_weight(PB: Array) -> float:
    """p: the largest weight of e_2 in PB [n, 3]."""
    return float(np.abs(PB[PB.shape[0] // 2 :]).max())


def projected_rate(W: Array, rate: Array, gamma: Array, weight_norm_max: float) -> Array:
    """The smooth projection operator, Gamma-weighted (Lavretsky and Wise, "Robust and Adaptive Control", 11.4).

    Returns `rate` unless norm(W) > W_max and the rate points outward; then its outward part is scaled away, wholly at
    norm(W)^2 = W_max^2 (1 + PROJECTION_MARGIN).

    Parameters
    ----------
    W, rate: [k, 3]; `rate` already carries Gamma.
    gamma: [k], the diagonal of Gamma.
    """
    limit = weight_norm_max * weight_norm_max
    f = (float(np.vdot(W, W)) - limit) / (PROJECTION_MARGIN * limit)
    if f <= 0.0:
        return rate
    outward = float(np.vdot(W, rate))
    if outward <= 0.0:
        return rate
    gamma_W = gamma[:, None] * W
    return rate - gamma_W * (min(f, 1.0) * outward / float(np.vdot(W, gamma_W)))


class LastLayer:
    """W of one channel and its law. nu_ad = W' Phi, in the units of the channel's u."""

    def __init__(self, config: AdaptationConfig, feature_count: int, PB: Array) -> None:
        """PB: [n, q], from the Lyapunov equation of the channel's reference model (tracking_weights).

        q is the number of outputs, 3 in a channel of the vehicle; where this class says 3, q is meant.
        """
        outputs = PB.shape[1]
        self.config = config
        self._bound2 = config.weight_norm_max**2
        self._safe_bound2 = self._bound2 * (1.0 + PROJECTION_MARGIN)
        self._PB = PB
        self._rate_weight = tracking_rate_weight(PB)
        self.W: Array = np.zeros((feature_count, outputs))
        self.memory: Array = np.zeros((feature_count, outputs))
        """theta_n, the trained last layer, towards which W leaks."""
        self._gamma = self._gamma_for(feature_count)
        self._change: Array = np.zeros((feature_count, outputs))
        self._direction: Array = np.zeros(outputs)
        self._norm2 = 0.0

    @property
    def gamma(self) -> Array:
        """[k], the diagonal of Gamma before normalisation."""
        return self._gamma

    def _gamma_for(self, feature_count: int) -> Array:
        gamma = np.ones(feature_count)
        gamma[-1] = self.config.bias_weight
        return gamma

    def replace(self, W: Array, memory: Array) -> None:
        """Takes over W [k, 3] and theta_n [k, 3] that belong to new features; W is clipped into the ball."""
        self.W = np.array(W)
        self.memory = np.array(memory)
        self._gamma = self._gamma_for(W.shape[0])
        self._change = np.zeros(W.shape)
        self._keep_in_ball()

    def learn(self, Phi: Array, channel: ChannelState, Delta_hat: Vector3) -> Array:
        """One tick of the law; returns nu [3, 2] at the columns of Phi [k, 2], the present state and the one ahead."""
        self.step(Phi[:, 0], channel.model_error, Delta_hat, channel.dt)
        return self.estimate(Phi)

    def estimate(self, Phi: Array) -> Array:
        """W'Phi [3, n] at the features Phi [k, n]."""
        nu: Array = np.dot(self.W.T, Phi)
        return nu

    def step(self, Phi: Array, e: Array, Delta_hat: Sequence[float], dt: float) -> None:
        """One step of W_dot = -Gamma Phi (gamma e'PB + lambda (W'Phi - Delta_hat)') / m^2 - sigma (W - theta_n).

        Parameters
        ----------
        Phi: [k], features at the present state.
        e: [n], x_rm - x; the second half is the rate of the first.
        Delta_hat: [3], filtered residual, units of u.
        dt: s.
        """
        config, W = self.config, self.W
        s = self._gain_along(Phi)
        m2 = config.normalisation_floor + s
        gamma, lambda_ = config.tracking_gain, config.composite_gain
        # Tracking term, implicit in its own effect on e_2 one step later.
        tracking = gamma / (1.0 + gamma * self._rate_weight * dt * dt) / m2
        d = [-tracking * ePB for ePB in e.dot(self._PB).tolist()]
        if lambda_ > 0.0:
            # Composite term, implicit in its rank-one part: W+ = W - a Gamma Phi (W+'Phi - Delta_hat)'.
            # The tracking term acts first; it changes W'Phi by s d dt.
            a = lambda_ * dt / m2
            composite = lambda_ / m2 / (1.0 + a * s)
            each_axis = zip(d, Phi.dot(W).tolist(), Delta_hat, strict=True)
            d = [di - composite * (nu + s * dt * di - Delta) for di, nu, Delta in each_axis]
        if not (s < SQUARE_MAX and sum(di * di for di in d) < SQUARE_MAX):  # NaN fails too
            return
        direction = self._direction
        direction[:] = [dt * di for di in d]
        change = np.multiply(Phi[:, None], direction, out=self._change)
        change[-1] *= config.bias_weight
        if self._norm2 > self._bound2:
            change = projected_rate(W, change, self._gamma, config.weight_norm_max)
        W += change
        if config.leak > 0.0:
            share = config.leak * dt
            W[:-1] += (share / (1.0 + share)) * (self.memory[:-1] - W[:-1])
        self._keep_in_ball()

    def _gain_along(self, Phi: Array) -> float:
        """Phi' Gamma Phi, where Gamma is 1 but for the last feature."""
        last = float(Phi[-1])
        return float(Phi.dot(Phi)) + (self.config.bias_weight - 1.0) * last * last

    def _keep_in_ball(self) -> None:
        self._norm2 = float(np.vdot(self.W, self.W))
        if self._norm2 > self._safe_bound2:
            self.W *= (self._safe_bound2 / self._norm2) ** 0.5
            self._norm2 = self._safe_bound2

    @property
    def weight_norm(self) -> float:
        """Frobenius norm of W, units of u."""
        return math.sqrt(self._norm2)
