"""The last-layer law with a covariance as a linear filter from the residual to nu, at constant features.

With the gains k_w and k_b (1/s) of W along Phi and of the fast bias b, and the filter 1 / (1 + T s) of the residual,

    F = k_w / (s + s_w) + k_b / (s + s_b),    nu = F (r / (1 + T s) - nu - t e'PB),    e = E (nu - r)
    nu / r = F (1 / (1 + T s) + t E') / (1 + F (1 + t E')),    E' = (w_1 + w_2 s) / (s^2 + k_2 s + k_1)

and e = E (nu - r + u - u_hat) where hedging leaves the lag in e, so that nu = (nu / r) r + H_e (u_hat - u) with

    H_e = F t E' / (1 + F (1 + t E')),

where w_1, w_2 are the weights of e_1 and e_2 in PB. k_w + k_b is Phi'S Phi / (R dt), at most composite_gain.

**A map with a slope.** With m the map's slope in x, constant, and the path at rest, nu takes up what the map says with
H = F (1 + t E') / (1 + F (1 + t E')): nu = (nu / r) r + (1 - H) m x. The map is read on the path, and the gap m x
passes a filter G of its own, which is H with one rate for W and b together (onboard/control/laws/path_gap.py):

    nu_cmd = (nu / r) r + (G - H) m x,    G = F_g (1 + t E') / (1 + F_g (1 + t E')),    F_g = k / (s + s_b k_b / k)

with k = k_w + k_b. So only the rest G - H of the slope is feedback.
"""

from typing import Any, Final, NamedTuple

import numpy as np

from onboard.control.laws.kalman_last_layer import KalmanConfig
from onboard.control.laws.last_layer import lyapunov_p, tracking_weights
from onboard.control.reference_model import ChannelGains

ACTIVE_FEATURES: Final = 10.0
"""Phi'Phi of the prediction: between 1, the constant alone, and k. It only divides the gain between W and b."""
SETTLING_TICKS: Final = 40000
"""Enough for 10 time constants of 1 / s_w at 200 Hz with the smallest shipped s_w."""


class LawResponse(NamedTuple):
    """The law at given gains; nu / r = numerator / (1 + loop), H_e = error / (1 + loop)."""

    numerator: Any
    """F (1 / (1 + T s) + t E')."""
    loop: Any
    """F (1 + t E')."""
    error: Any
    """F t E'."""

    @property
    def filter(self) -> Any:
        """nu / r."""
        return self.numerator / (1.0 + self.loop)

    @property
    def takes_up(self) -> Any:
        """H: the share of what a map says that the law takes up, with the other sign."""
        return self.loop / (1.0 + self.loop)


def fastest_response(
    law: KalmanConfig, error_weight: tuple[float, float], gains: ChannelGains, axis: int, s: Any
) -> LawResponse:
    """The law at the largest gain that it can have: composite_gain, divided as S0 says.

    That is the law after its start and after a swap. As S falls, the gain does: margins here are margins there.
    """
    share = _share_of_W(law)
    return _response(law, error_weight, gains, axis, s, law.composite_gain * share, law.composite_gain * (1.0 - share))


def _share_of_W(law: KalmanConfig) -> float:
    """k_w / (k_w + k_b) where S = S0."""
    of_W, of_b = law.prior**2 * ACTIVE_FEATURES, law.fast_bias**2
    return of_W / (of_W + of_b)


def settled_response(
    law: KalmanConfig, error_weight: tuple[float, float], gains: ChannelGains, axis: int, s: Any, dt: float
) -> LawResponse:
    """The law at the stationary covariance of constant features, the least gain that it comes to."""
    k_w, k_b = settled_gains(law, dt)
    return _response(law, error_weight, gains, axis, s, k_w, k_b)


def slope_fed_back(law: KalmanConfig, error_weight: tuple[float, float], gains: ChannelGains, axis: int, s: Any) -> Any:
    """G - H at the largest gain of the law: the share of the map's slope that is feedback of the loop."""
    F = law.composite_gain / (s + law.fast_bias_rate * (1.0 - _share_of_W(law)))
    F = F * (1.0 + _tracking(law, error_weight, gains, axis, s))
    return F / (1.0 + F) - fastest_response(law, error_weight, gains, axis, s).takes_up


def settled_gains(law: KalmanConfig, dt: float) -> tuple[float, float]:
    """k_w and k_b, 1/s, at the fixed point of the covariance of (W'Phi, b) with ticks of dt, s."""
    of_W, of_b = law.prior**2 * ACTIVE_FEATURES, law.fast_bias**2
    keep_W, keep_b = np.exp(-law.prior_rate * dt), np.exp(-law.fast_bias_rate * dt)
    p, q, r = of_W, 0.0, of_b
    for _ in range(SETTLING_TICKS):
        p = keep_W**2 * p + (1.0 - keep_W**2) * of_W
        q *= keep_W * keep_b
        r = keep_b**2 * r + (1.0 - keep_b**2) * of_b
        g_W, g_b = p + q, q + r
        v = max(law.noise**2, (g_W + g_b) / (law.composite_gain * dt)) + g_W + g_b
        p, q, r = p - g_W * g_W / v, q - g_W * g_b / v, r - g_b * g_b / v
    return float(g_W / v / dt), float(g_b / v / dt)


def _response(
    law: KalmanConfig,
    error_weight: tuple[float, float],
    gains: ChannelGains,
    axis: int,
    s: Any,
    k_w: float,
    k_b: float,
) -> LawResponse:
    tracking = _tracking(law, error_weight, gains, axis, s)
    F = k_w / (s + law.prior_rate) + k_b / (s + law.fast_bias_rate)
    taken = F * (1.0 / (1.0 + law.residual_filter_s * s) + tracking)
    return LawResponse(taken, F * (1.0 + tracking), F * tracking)


def _tracking(law: KalmanConfig, error_weight: tuple[float, float], gains: ChannelGains, axis: int, s: Any) -> Any:
    """t E'."""
    Q = np.diag(np.repeat(np.array(error_weight), 3))
    PB = tracking_weights(lyapunov_p(gains.closed_loop_matrix(), Q), gains.natural_frequency_rad_s)
    k1, k2 = gains.stiffness()[axis], gains.rate_gain()[axis]
    t = law.tracking_gain / law.composite_gain if law.composite_gain > 0.0 else 0.0
    return t * (PB[axis, axis] + PB[3 + axis, axis] * s) / (s**2 + k2 * s + k1)
