"""The linear filter of the law with a covariance against the law itself, and the margins at its largest gain."""

from math import exp
from typing import Any

import numpy as np
import pytest

from configs.loader import CONFIG_DIRECTORY, load
from experiments.flights.scenario import Choices, resolve
from experiments.margins import steepest_map
from experiments.margins.kalman import (
    ACTIVE_FEATURES,
    fastest_response,
    settled_gains,
    settled_response,
)
from experiments.margins.linear import predicted_loop
from experiments.margins.requirement import OMEGA, MarginRequirement
from experiments.margins.stability import margins
from experiments.margins.steepest_map import steepest_map_margins
from onboard.control.laws.kalman_last_layer import KalmanConfig, KalmanLastLayer
from onboard.control.laws.last_layer import lyapunov_p, tracking_weights
from onboard.control.reference_model import ChannelGains
from protocol.feature_config import FeaturesConfig

DT = 0.005
FEATURES = load(FeaturesConfig, CONFIG_DIRECTORY / "features.yaml")
GAINS = ChannelGains(natural_frequency_rad_s=(6.0, 6.0, 5.0), damping=0.8)
ERROR_WEIGHT = (1.0, 0.1)
ENOUGH = MarginRequirement(gain_margin_db=6.0, phase_margin_deg=35.0, delay_margin_ms=15.0)


def law_of(**over: float) -> KalmanConfig:
    values = {
        "tracking_gain": 60.0, "composite_gain": 12.0, "noise": 1.0, "prior": 0.4, "fast_bias": 1.0, "prior_rate": 0.03,
        "fast_bias_rate": 2.0, "weight_norm_max": 1e3,
    }  # fmt: skip
    return KalmanConfig(kind="kalman", **(values | over))


def gain_of_the_law(law: KalmanConfig, omega: float) -> complex:
    """nu / r of the law itself, settled at constant features with |Phi|^2 = ACTIVE_FEATURES, at one frequency.

    The law gets the mean of two ticks of its filter: the residual of a tick is a mean over the tick, half a tick old.
    """
    Q = np.diag(np.repeat(ERROR_WEIGHT, 3))
    PB = tracking_weights(lyapunov_p(GAINS.closed_loop_matrix(), Q), GAINS.natural_frequency_rad_s)
    one = KalmanLastLayer(law, int(ACTIVE_FEATURES), PB, GAINS.pairs())
    Phi = np.ones((int(ACTIVE_FEATURES), 3))
    k1, k2 = GAINS.stiffness()[0], GAINS.rate_gain()[0]
    e, e_dot, r, filtered, nu = 0.0, 0.0, 0.0, 0.0, 0.0
    outputs, inputs = [], []
    period = round(2.0 * np.pi / omega / DT)
    settle = 20_000
    for tick in range(settle + 4 * period):
        acceleration = -k1 * e - k2 * e_dot + nu - r  # e of nu - Delta, advanced by what acted since the last tick
        e, e_dot = e + DT * e_dot + 0.5 * DT**2 * acceleration, e_dot + DT * acceleration
        r = float(np.sin(2.0 * np.pi * tick / period)) if tick >= settle - 2 * period else 0.0
        last, filtered = filtered, filtered + (1.0 - exp(-DT / law.residual_filter_s)) * (r - filtered)
        error = np.array([e, 0.0, 0.0, e_dot, 0.0, 0.0])
        nu = float(one.step(Phi, error, [0.5 * (last + filtered), 0.0, 0.0], DT)[0, 0])
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
    predicted = complex(settled_response(law, ERROR_WEIGHT, GAINS, 0, s, DT).filter[0])
    assert abs(found - predicted) < 0.08 * max(abs(predicted), 0.3)


def test_no_gain_exceeds_the_fastest() -> None:
    law = law_of(noise=0.01)
    k_w, k_b = settled_gains(law, DT)
    assert k_w + k_b <= law.composite_gain
    assert k_w + k_b > 0.9 * law.composite_gain / (1.0 + law.composite_gain * DT)
    high = 1j * np.array([1e4])
    gain = abs(fastest_response(law, ERROR_WEIGHT, GAINS, 0, high).takes_up[0])
    assert gain * 1e4 == pytest.approx(law.composite_gain, rel=0.02)


def test_a_law_without_gain_has_no_loop() -> None:
    s = 1j * OMEGA
    assert np.abs(fastest_response(law_of(composite_gain=0.0), ERROR_WEIGHT, GAINS, 0, s).filter).max() == 0.0


def test_the_margins_of_dmrac_hold_at_the_largest_gain_of_its_law_whatever_the_prior_says() -> None:
    law = "onboard.controller.settings.attitude.augmentation.law"
    for sets in ((), (f"{law}.prior=50.0",), (f"{law}.noise=0.1",), (f"{law}.fast_bias=100.0",)):
        config = resolve("hover", Choices("dmrac", assignments=sets))
        assert ENOUGH.shortfall(config) == 0.0


@pytest.mark.parametrize("times", [1.0, 20.0])
def test_the_margins_of_dmrac_hold_with_the_steepest_map_that_is_accepted(times: float) -> None:
    """And with one far steeper: the gap passes the law's own filter, so that a slope is no feedback."""
    config = resolve("hover", Choices("dmrac"))
    found = list(steepest_map_margins(config, OMEGA, times))
    assert {(one.channel, one.over, one.axis) for one in found} == {
        (channel, over, axis)
        for channel, axes in ((0, 3), (1, 2))
        for over in ("place", "motion")
        for axis in range(axes)
    }
    for one in found:
        assert one.margins.phase_margin_deg >= 35.0, one
        assert one.margins.gain_margin_db >= 6.0, one
        assert one.margins.delay_margin_ms >= 15.0, one
    if times == 1.0:
        assert ENOUGH.shortfall_with_the_steepest_map(config) == 0.0


@pytest.mark.parametrize("gap_filter", ["none", "without the tracking term"])
def test_another_filter_of_the_gap_costs_the_margins(gap_filter: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ablation: the map read at the vehicle, or a gap that follows at composite_gain alone."""

    def fed_back(law: KalmanConfig, error_weight: tuple[float, float], gains: ChannelGains, axis: int, s: Any) -> Any:
        gap = 1.0 if gap_filter == "none" else law.composite_gain / (s + law.composite_gain + law.fast_bias_rate)
        return gap - fastest_response(law, error_weight, gains, axis, s).takes_up

    monkeypatch.setattr(steepest_map, "slope_fed_back", fed_back)
    assert ENOUGH.shortfall_with_the_steepest_map(resolve("hover", Choices("dmrac"))) > 0.1


def test_a_law_whose_map_is_not_read_on_the_path_has_no_such_margins() -> None:
    assert list(steepest_map_margins(resolve("hover", Choices("mrac")), OMEGA)) == []
    assert ENOUGH.shortfall_with_the_steepest_map(resolve("hover", Choices("mrac"))) == 0.0


def test_the_limit_is_what_keeps_the_margins() -> None:
    law = "onboard.controller.settings.attitude.augmentation.law"
    config = resolve("hover", Choices("dmrac", assignments=(f"{law}.composite_gain=60.0",)))
    found = margins(OMEGA, predicted_loop(config, 1, 0, OMEGA))
    assert found.phase_margin_deg < 35.0
