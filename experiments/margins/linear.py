"""Linear prediction of the open loops, from gains, law, motor lag and dead time alone.

Broken at the demand u, with A the actuators with all dead time, K the feedback and H the law as a filter from the
residual to nu_ad:

    attitude:  L = (K A / s^2 + H A) / (1 - H A)             the law sees the residual x_ddot - A u
    position:  L = K T / s^2                                 T: from commanded to true attitude

With prediction over the dead time d, K A / s^2 = L_0 exp(-d s) becomes L_0 exp(-d s) / (1 + L_0 (1 - exp(-d s))).
"""

from typing import Any, Final

import numpy as np

from experiments.flights.scenario import FlightConfig
from experiments.margins.kalman import fastest_filter
from onboard.control.cascade import CascadeSettings, ChannelSettings
from onboard.control.laws.adaptive import AdaptiveConfig
from onboard.control.laws.indi import IncrementalConfig
from onboard.control.laws.integral import IntegralConfig
from onboard.control.laws.kalman_last_layer import KalmanConfig
from onboard.control.laws.l1 import L1Config
from protocol.conventions import Array

HOLD_TICKS: Final = 0.5
COMMAND_TICKS: Final = 1.0
"""A command acts one tick after it was computed, and is held for a tick."""


def predicted_loop(config: FlightConfig, channel: int, axis: int, omega: Array) -> Any:
    """L(j omega) [n] of one axis; channel 0 position, 1 attitude; omega [n], rad/s.

    Raises
    ------
    ValueError
        If the controller is not a cascade.
    """
    settings = config.onboard.controller.filled_settings(config.onboard.features)
    if not isinstance(settings, CascadeSettings):
        raise ValueError(f"{config.controller}: not a cascade, so there is no linear prediction")
    s = 1j * omega
    if channel == 1:
        return _attitude(config, settings, axis, s)
    K = _feedback(settings.position, axis, s)
    if axis == 2:
        return K * _actuators(config, s) * np.exp(-_dead_time_s(config, 0.0) * s) / s**2
    return K * _closed_attitude(config, settings, 1 - axis, s) / s**2  # north is flown by pitch, east by roll


def _closed_attitude(config: FlightConfig, settings: CascadeSettings, axis: int, s: Any) -> Any:
    """From commanded to true attitude: the law cancels out, and the rate feedback is not driven by the command."""
    plant = _actuators(config, s) / s**2
    delay = np.exp(-_dead_time_s(config, config.onboard.estimator.gyro_delay_s) * s)
    K = _feedback(settings.attitude, axis, s)
    k1, k2 = settings.attitude.gains.stiffness()[axis], settings.attitude.gains.rate_gain()[axis]
    filter_s = settings.command_rate_filter_s
    command = k1 + k2 * s / (1.0 + filter_s * s) if filter_s > 0.0 else k1
    return command * plant * delay / (1.0 + K * plant * (1.0 if settings.prediction else delay))


def _attitude(config: FlightConfig, settings: CascadeSettings, axis: int, s: Any) -> Any:
    K, H = _feedback(settings.attitude, axis, s), _law(settings.attitude, axis, s)
    A = _actuators(config, s)
    delay = np.exp(-_dead_time_s(config, config.onboard.estimator.gyro_delay_s) * s)
    L_0 = K * A / s**2
    feedback = L_0 * delay / (1.0 + L_0 * (1.0 - delay)) if settings.prediction else L_0 * delay
    return (feedback + H * A * delay) / (1.0 - H * A * delay)


def _actuators(config: FlightConfig, s: Any) -> Any:
    """First-order lag of the simulated motors, driven by the compensation that onboard computes for its nominal lag."""
    motors, airframe = config.vehicle.motors, config.onboard.airframe
    lag = 0.5 * (motors.lag_up_s + motors.lag_down_s)
    nominal = 0.5 * (airframe.motor_lag_up_s + airframe.motor_lag_down_s)
    tau = lag * min(airframe.motor_response_s / nominal, 1.0)
    return 1.0 / (1.0 + tau * s)


def _dead_time_s(config: FlightConfig, sensor_s: float) -> float:
    period_s = config.onboard.period_ns * 1e-9
    return sensor_s + (COMMAND_TICKS + HOLD_TICKS) * period_s + config.vehicle.motors.command_delay_s


def _feedback(channel: ChannelSettings, axis: int, s: Any) -> Any:
    k1, k2 = channel.gains.stiffness()[axis], channel.gains.rate_gain()[axis]
    law = channel.augmentation
    integral = law.gain[axis] / s if isinstance(law, IntegralConfig) else 0.0
    return k1 + k2 * s + integral


def _law(channel: ChannelSettings, axis: int, s: Any) -> Any:
    """nu_ad / residual."""
    law, gains = channel.augmentation, channel.gains
    match law:
        case L1Config():
            return law.bandwidth_rad_s / (s + law.bandwidth_rad_s)
        case IncrementalConfig():  # a lap's table changes once per lap
            return 1.0 / (1.0 + law.filter_s * s)
        case AdaptiveConfig(law=KalmanConfig() as covariance):
            return fastest_filter(covariance, law.error_weight, gains, axis, s)
        case AdaptiveConfig():
            k1, k2 = gains.stiffness()[axis], gains.rate_gain()[axis]
            rate_weight = law.error_weight[1] / law.error_weight[0]
            error = (1.0 + rate_weight * s) / (s**2 + k2 * s + k1)  # e for nu_ad - Delta
            tracking = law.law.tracking_gain * error
            composite = law.law.composite_gain / (1.0 + law.law.residual_filter_s * s)
            return (composite + tracking) / (s + law.law.composite_gain + tracking)
        case _:
            return np.zeros_like(s)
