"""The linear filter of the law with a covariance against the law itself, and the margins at its largest gain."""

from math import inf
from typing import Any

import numpy as np
import pytest

from configs.loader import CONFIG_DIRECTORY, load
from experiments.flights.scenario import Choices, resolve
from experiments.margins.kalman import (
    ACTIVE_FEATURES,
    fastest_filter,
    settled_filter,
    settled_gains,
    slope_fed_back,
)
from experiments.margins.linear import predicted_loop
from experiments.margins.requirement import OMEGA, MarginRequirement
from experiments.margins.stability import margins
from onboard.control.laws.kalman_last_layer import KalmanConfig, KalmanLastLayer
from onboard.control.laws.last_layer import lyapunov_p, tracking_weights
from onboard.control.reference_model import ChannelGains
from protocol.feature_config import FeaturesConfig

DT = 0.005
FEATURES = load(FeaturesConfig, CONFIG_DIRECTORY / "features.yaml")
GAINS = ChannelGains(natural_frequency_rad_s=(6.0, 6.0, 5.0), damping=0.8)
ERROR_WEIGHT = (1.0, 0.1)


def law_of(**over: float) -> KalmanConfig:
    values = {
        "tracking_gain": 60.0, "composite_gain": 12.0, "noise": 1.0, "prior": 0.4, "fast_bias": 1.0, "prior_rate": 0.03,
        "fast_bias_rate": 2.0, "weight_norm_max": 1e3,
    }  # fmt: skip
    return KalmanConfig(kind="kalman", **(values | over))


def gain_of_the_law(law: KalmanConfig, omega: float) -> complex:
    """nu / r of the law itself, settled at constant features with |Phi|^2 = ACTIVE_FEATURES, at one frequency."""
    Q = np.diag(np.repeat(ERROR_WEIGHT, 3))
    PB = tracking_weights(lyapunov_p(GAINS.closed_loop_matrix(), Q), GAINS.natural_frequency_rad_s)
    one = KalmanLastLayer(law, int(ACTIVE_FEATURES), PB, GAINS.pairs())
    Phi = np.ones((int(ACTIVE_FEATURES), 3))
    k1, k2 = GAINS.stiffness()[0], GAINS.rate_gain()[0]
    e, e_dot, r, nu = 0.0, 0.0, 0.0, 0.0
    outputs, inputs = [], []
    period = round(2.0 * np.pi / omega / DT)
    settle = 20_000
    for tick in range(settle + 4 * period):
        acceleration = -k1 * e - k2 * e_dot + nu - r  # e of nu - Delta, advanced by what acted since the last tick
        e, e_dot = e + DT * e_dot + 0.5 * DT**2 * acceleration, e_dot + DT * acceleration
        r = float(np.sin(2.0 * np.pi * tick / period)) if tick >= settle - 2 * period else 0.0
        error = np.array([e, 0.0, 0.0, e_dot, 0.0, 0.0])
        nu = float(one.step(Phi, error, [r, 0.0, 0.0], DT)[0, 0])
        if tick >= settle + 2 * period:
            inputs.append(r)
            outputs.append(nu)
    turn = np.exp(-2j * np.pi * np.arange(len(inputs)) / period)
    return complex((np.array(outputs) @ turn) / (np.array(inputs) @ turn))


@pytest.mark.parametrize("omega", [2.0, 8.0, 20.0])
def test_the_settled_filter_is_that_of_the_law(omega: float) -> None:
    law = law_of()
    found = gain_of_the_law(law, omega)
    s = np.array([2j * np.pi / (round(2.0 * np.pi / omega / DT) * DT)])
    predicted = complex(settled_filter(law, ERROR_WEIGHT, GAINS, 0, s, DT)[0])
    assert abs(found - predicted) < 0.08 * max(abs(predicted), 0.3)


def test_no_gain_exceeds_the_fastest() -> None:
    law = law_of(noise=0.01)
    k_w, k_b = settled_gains(law, DT)
    assert k_w + k_b <= law.composite_gain
    assert k_w + k_b > 0.9 * law.composite_gain / (1.0 + law.composite_gain * DT)
    high = 1j * np.array([1e4])
    gain = abs(fastest_filter(law, ERROR_WEIGHT, GAINS, 0, high)[0])
    assert gain * 1e4 == pytest.approx(law.composite_gain, rel=0.02)


def test_a_law_without_gain_has_no_loop() -> None:
    s = 1j * OMEGA
    assert np.abs(fastest_filter(law_of(composite_gain=0.0), ERROR_WEIGHT, GAINS, 0, s)).max() == 0.0


def test_the_margins_of_dmrac_hold_at_the_largest_gain_of_its_law_whatever_the_prior_says() -> None:
    law = "onboard.controller.settings.attitude.augmentation.law"
    requirement = MarginRequirement(gain_margin_db=6.0, phase_margin_deg=35.0, delay_margin_ms=15.0)
    for sets in ((), (f"{law}.prior=50.0",), (f"{law}.noise=0.1",), (f"{law}.fast_bias=100.0",)):
        config = resolve("hover", Choices("dmrac", assignments=sets))
        assert requirement.shortfall(config) == 0.0


@pytest.mark.parametrize(("times", "enough"), [(1.0, True), (6.0, False)])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_margins_of_dmrac_hold_with_the_steepest_map_that_is_accepted(
    axis: int, times: float, enough: bool
) -> None:
    """A slope over position or velocity at its limit, with either sign; and at several times the limit."""
    config = resolve("hover", Choices("dmrac"))
    settings: Any = config.onboard.controller.filled_settings(FEATURES)
    gains, augmentation = settings.position.gains, settings.position.augmentation
    s = 1j * OMEGA
    fed_back = slope_fed_back(augmentation.law, augmentation.error_weight, gains, axis, s)
    k1, k2 = gains.stiffness()[axis], gains.rate_gain()[axis]
    plant = predicted_loop(config, 0, axis, OMEGA) / (k1 + k2 * s)
    shares = augmentation.slope_shares
    worst = inf
    for slope in (shares.place * k1, shares.motion * k2 * s):
        for sign in (-times, times):
            found = margins(OMEGA, plant * (k1 + k2 * s + sign * fed_back * slope))
            worst = min(worst, found.phase_margin_deg / 35.0, found.gain_margin_db / 6.0, found.delay_margin_ms / 15.0)
    assert bool(worst >= 1.0) is enough


@pytest.mark.parametrize(("gap", "enough"), [(True, True), (False, False)])
def test_a_map_of_the_attitude_over_the_place_leaves_the_position_loop_its_margins(gap: bool, enough: bool) -> None:
    """As steep as is accepted: nu / K_1 is a tilt, so the slope is one of the position loop (onboard/control/slope.py).

    Ablation: read at the vehicle, all of the slope is fed back but for what the law, slower here, takes up.
    """
    config = resolve("hover", Choices("dmrac"))
    settings: Any = config.onboard.controller.filled_settings(FEATURES)
    augmentation, s = settings.attitude.augmentation, 1j * OMEGA
    of_law = augmentation.law, augmentation.error_weight, settings.attitude.gains, 1, s
    fed_back = slope_fed_back(*of_law) if gap else 1.0 - fastest_filter(*of_law)
    k1, k2 = settings.position.gains.stiffness()[0], settings.position.gains.rate_gain()[0]
    loop = predicted_loop(config, 0, 0, OMEGA)
    slope = augmentation.slope_shares.place * k1 / (k1 + k2 * s)
    worst = min(margins(OMEGA, loop * (1.0 + sign * fed_back * slope)).phase_margin_deg for sign in (-1.0, 1.0))
    assert bool(worst >= 35.0) is enough


def test_the_limit_is_what_keeps_the_margins() -> None:
    law = "onboard.controller.settings.attitude.augmentation.law"
    config = resolve("hover", Choices("dmrac", assignments=(f"{law}.composite_gain=60.0",)))
    found = margins(OMEGA, predicted_loop(config, 1, 0, OMEGA))
    assert found.phase_margin_deg < 35.0
