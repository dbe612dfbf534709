"""Linear prediction of the open loops, from gains, law, vehicle and dead time alone.

The vehicle (`config.vehicle`) may differ from the one that onboard assumes (`config.onboard.airframe`):

    G = gain A exp(-d s)        what the vehicle's actuators do with a demand: true gain, lag and dead time
    A_n exp(-d_n s)             what onboard believes they do: u_hat (experiments/margins/plant.py has both)
    K = k_1 + k_2 s             the feedback, and H the law as a filter from the residual to nu_ad
    H_e                         the law as a filter from u_hat - u to nu_ad, where hedging leaves that in e; else 0
    Q = K A_n (1 - exp(-d_n s)) / s^2    prediction over the dead time that onboard knows; 0 without

**Attitude.** The law sees r = x_ddot - A_n exp(-d_n s) u, and the feedback the state predicted from u and nu_ad:

    u = -K G / s^2 u' - Q (u + nu_ad) - nu_ad,    nu_ad = H (G u' - A_n exp(-d_n s) u) + H_e (A_n exp(-d_n s) - 1) u

Broken between the demand u and the vehicle, u' = -L^-1 u, so the loop has the delay that onboard does not know:

    L = (K G / (1 + Q) / s^2 + H G) / (1 - H A_n exp(-d_n s) + H_e (A_n exp(-d_n s) - 1))

Two things are simplified: the turn over the dead time comes from the model, where onboard takes the measured rate, and
nu_ad passes through A_n there. From commanded to true attitude, with C the feedback on a command,

    T = C G / s^2 / ((1 + Q) (1 + H (G - A_n exp(-d_n s)) + H_e (A_n exp(-d_n s) - 1)) + K G / s^2)

and the residual's filter cancels out where G is the nominal plant.

**Position.** With rho the lift by the thrust at a command over the nominal one, the thrust demand settles at g / rho,
which makes the tilt for a demand rho times as large. u_hat follows from the attitude as measured, so lag and dead time
are known, rho is not: horizontally r = (rho - 1) T u. Vertically u_hat follows from the motors' model. Broken at the
demand, with u_hat aware of it,

    horizontal: L = (rho K T / s^2 + H (rho - 1) T + H_e T) / (1 - H_e)
    vertical:   L = (K G / s^2 + H (G - A_n exp(-d_n s)) + H_e A_n exp(-d_n s)) / (1 - H_e).

**Stability.** Margins mean nothing where the closed loop is unstable. 1 + L over a common denominator, times that of H,
is the characteristic function. Its zeros in the right half plane are the unstable poles; stability.py counts them.
"""

from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np

from experiments.flights.scenario import FlightConfig
from experiments.margins.kalman import fastest_response
from experiments.margins.plant import attitude_plant, lift_gain, lift_plant
from onboard.control.cascade import CascadeSettings, ChannelSettings
from onboard.control.laws.adaptive import AdaptiveConfig
from onboard.control.laws.indi import IncrementalConfig
from onboard.control.laws.integral import IntegralConfig
from onboard.control.laws.kalman_last_layer import KalmanConfig
from onboard.control.laws.l1 import L1Config
from protocol.conventions import Array

SCALE_RAD_S: Final = 10.0
"""The characteristic function is scaled by powers of s / (s + this): then it is finite at 0, and 1 at infinity."""


class Law(NamedTuple):
    """H = numerator / denominator and H_e = error / denominator, each without poles in the right half plane; the
    denominator is 1 at infinity.
    """

    numerator: Any
    denominator: Any
    error: Any = 0.0


class PredictedLoop(NamedTuple):
    """One loop, [n] each."""

    L: Any
    """Open loop, broken at the demand."""
    characteristic: Any
    """Its zeros in the right half plane are unstable closed-loop poles; it has no poles there, and is 1 at infinity."""


class LinearModel:
    """All loops of a controller with a vehicle, at the frequencies omega [n], rad/s."""

    def __init__(self, config: FlightConfig, omega: Array) -> None:
        """Raise ValueError if the controller is not a cascade."""
        settings = config.onboard.controller.filled_settings(config.onboard.features)
        if not isinstance(settings, CascadeSettings):
            raise ValueError(f"{config.controller}: not a cascade, so there is no linear prediction")
        self._config, self._settings, self._s = config, settings, 1j * omega

    def loop(self, channel: int, axis: int, added: Any = 0.0) -> PredictedLoop:
        """One loop: channel 0 position, 1 attitude. `added` [n]: to the feedback K of a position loop."""
        if channel == 1:
            return self.attitude[axis].loop
        return self._vertical(added) if axis == 2 else self._horizontal(axis, added)

    @cached_property
    def attitude(self) -> "tuple[_AttitudeLoop, _AttitudeLoop, _AttitudeLoop]":
        """Roll, pitch and yaw."""
        roll, pitch, yaw = (_AttitudeLoop(self._config, self._settings, axis, self._s) for axis in range(3))
        return roll, pitch, yaw

    def _horizontal(self, axis: int, added: Any) -> PredictedLoop:
        T = self.attitude[1 - axis].closed()  # north is flown by pitch, east by roll
        rho = lift_gain(self._config)
        return self._position(axis, added, rho * T, T)

    def _vertical(self, added: Any) -> PredictedLoop:
        plant = lift_plant(self._config, self._s)
        return self._position(2, added, plant.true, plant.nominal)

    def _position(self, axis: int, added: Any, true: Any, known: Any) -> PredictedLoop:
        """The loop with what a demand does, and with what u_hat knows of that."""
        s, channel = self._s, self._settings.position
        K, law = _feedback(channel, axis, s) + added, _law(self._settings, channel, axis, s)
        feedback = K * true / s**2
        learnt = law.numerator * (true - known) + law.error * known
        L = (law.denominator * feedback + learnt) / (law.denominator - law.error)
        return PredictedLoop(L, _scaled(law.denominator * (1.0 + feedback) + learnt - law.error, channel, s))


class _AttitudeLoop:
    """The loop of one axis of the attitude channel; the symbols are those at the head of this file."""

    def __init__(self, config: FlightConfig, settings: CascadeSettings, axis: int, s: Any) -> None:
        channel, plant = settings.attitude, attitude_plant(config, axis, s)
        self._settings, self._axis, self._s, self._G = settings, axis, s, plant.true
        K, law = _feedback(channel, axis, s), _law(settings, channel, axis, s)
        Q = K * (plant.nominal_prompt - plant.nominal) / s**2 if settings.prediction else 0.0
        KG = K * plant.true / s**2
        H, H_e = law.numerator / law.denominator, law.error / law.denominator
        lag = H_e * (plant.nominal - 1.0)
        self._denominator = (1.0 + Q) * (1.0 + H * (plant.true - plant.nominal) + lag) + KG
        L = (KG / (1.0 + Q) + H * plant.true) / (1.0 - H * plant.nominal + lag)
        self.loop = PredictedLoop(L, _scaled(law.denominator * self._denominator, channel, s))

    def closed(self) -> Any:
        """T, from commanded to true attitude. The rate feedback is not driven by the command, but fed forward."""
        channel, s, filter_s = self._settings.attitude, self._s, self._settings.command_rate_filter_s
        k2 = channel.gains.rate_gain()[self._axis]
        rate = k2 * s
        C = _feedback(channel, self._axis, s) - rate + (rate / (1.0 + filter_s * s) if filter_s > 0.0 else 0.0)
        return C * self._G / s**2 / self._denominator


def predicted_loop(config: FlightConfig, channel: int, axis: int, omega: Array) -> Any:
    """L(j omega) [n] of one axis; channel 0 position, 1 attitude; omega [n], rad/s.

    Raises
    ------
    ValueError
        If the controller is not a cascade.
    """
    return LinearModel(config, omega).loop(channel, axis).L


def _scaled(characteristic: Any, channel: ChannelSettings, s: Any) -> Any:
    """Times (s / (s + SCALE))^n, n the number of poles at 0."""
    poles = 3 if isinstance(channel.augmentation, IntegralConfig) else 2
    return characteristic * (s / (s + SCALE_RAD_S)) ** poles


def _feedback(channel: ChannelSettings, axis: int, s: Any) -> Any:
    k1, k2 = channel.gains.stiffness()[axis], channel.gains.rate_gain()[axis]
    law = channel.augmentation
    integral = law.gain[axis] / s if isinstance(law, IntegralConfig) else 0.0
    return k1 + k2 * s + integral


def _law(settings: CascadeSettings, channel: ChannelSettings, axis: int, s: Any) -> Law:
    """nu_ad / residual, and nu_ad / what hedging leaves in e."""
    law, gains, left = channel.augmentation, channel.gains, 0.0 if settings.hedging == "all" else 1.0
    match law:
        case L1Config():
            return Law(law.bandwidth_rad_s / (s + law.bandwidth_rad_s), 1.0)
        case IncrementalConfig():  # a lap's table changes once per lap
            return Law(1.0 / (1.0 + law.filter_s * s), 1.0)
        case AdaptiveConfig(law=KalmanConfig() as covariance):
            response = fastest_response(covariance, law.error_weight, gains, axis, s)
            return Law(response.numerator, 1.0 + response.loop, left * response.error)
        case AdaptiveConfig():
            k1, k2 = gains.stiffness()[axis], gains.rate_gain()[axis]
            rate_weight = law.error_weight[1] / law.error_weight[0]
            error = (1.0 + rate_weight * s) / (s**2 + k2 * s + k1)  # e for nu_ad - Delta
            tracking = law.law.tracking_gain * error
            pole = law.law.composite_gain
            composite = pole / (1.0 + law.law.residual_filter_s * s)
            over = s + pole + SCALE_RAD_S
            return Law((composite + tracking) / over, (s + pole + tracking) / over, left * tracking / over)
        case _:
            return Law(np.zeros_like(s), 1.0)
