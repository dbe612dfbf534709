"""The test of a version before it flies: the C core against numpy's."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.c.library import Core
from onboard.control.features import BiasFeatures, Features, NetworkFeatures
from onboard.control.slope import SlopeLimits, SlopeShares
from onboard.control.version_test import VersionTest, VersionTestConfig, ahead
from protocol.messages import REFUSALS
from protocol.signals import SIGNAL_COUNT, SIGNAL_INDEX
from tests.onboard.c.channels import c_network_features, channel, signals
from tests.onboard.c.parity import SETTINGS, array, call, configured, same
from tests.onboard.c.test_laws import GAINS
from tests.onboard.control.fixture import shipped_controller
from tests.onboard.control.guard_rig import version
from tests.onboard.control.test_guard import cliff

SIDES: Any = ("position", "attitude")
RTOL = 1e-11
SHARES = SlopeShares(place=1.0, motion=0.8, turn=0.6)


class Both:
    """The two tests, side by side."""

    def __init__(self, core: Core, config: VersionTestConfig, side: int) -> None:
        self.core, self.ours, limits = core, core.VersionTest(), core.SlopeLimits()
        gains, shares = configured(core, GAINS), configured(core, SHARES)
        core.slope_limits_of(side, gains, gains, shares, limits)
        core.version_test_init(self.ours, configured(core, config), side, limits)
        self.theirs = VersionTest(config, side, SlopeLimits.of(SIDES[side], GAINS, GAINS, SHARES))

    def refusal(self, ours: Any, features: Features, theta: Any, now: Any, recent: Any, residuals: Any) -> str:
        """The refusal of both; recent: [n, SIGNAL_COUNT]."""
        expected = self.theirs.refusal(features, theta, now, recent.T, residuals)
        states, measured = (
            array(self.core, one) if one.size else array(self.core, [0.0]) for one in (recent, residuals)
        )
        refusal = self.core.version_test_refusal(
            self.ours, ours, array(self.core, theta), array(self.core, now), states, measured, len(recent)
        )
        self.compare(now)
        assert REFUSALS[refusal] == expected
        return expected

    def look(self, ours: Any, features: Features, theta: Any, now: Any) -> bool:
        """A whole check of the map that flies, part by part, by both."""
        while True:
            expected = self.theirs.look(features, theta, now)
            over = self.core.version_test_look(self.ours, ours, array(self.core, theta), array(self.core, now))
            assert over == (expected is not None)
            assert self.ours.looks == self.theirs.looks
            if expected is not None:
                assert self.ours.good == expected
                return expected

    def still_good(self, ours: Any, features: Features, theta: Any, now: Any) -> bool:
        expected = self.look(ours, features, theta, now)
        self.compare(now, self.ours.look)
        return expected

    def compare(self, now: Any, looked: Any = None) -> None:
        """States looked at, and what was found there."""
        found = self.ours.found
        numbers = [found.bound, found.spread, found.along, found.over, found.misfit]
        for own, other in zip(numbers, self.theirs.found, strict=True):
            same(own, other, rtol=RTOL, scale=1e-2)
        path, box = ahead(self.theirs._config, np.asarray(now))
        for index, state in enumerate(np.hstack([path, box]).T):
            own = call(self.core, "ahead_state", looked or self.ours.ahead, self.ours, index, out=SIGNAL_COUNT)
            same(own, state, scale=1.0)


@SETTINGS
@given(
    seed=st.integers(0, 2**31),
    side=st.integers(0, 1),
    kept=st.sampled_from([0, 1, 40, 200]),
    gain=st.sampled_from([0.03, 0.3, 1.0]),
    size=st.sampled_from([0.05, 0.5, 5.0]),
    speed=st.sampled_from([0.0, 1.0, 4.0]),
    sees=st.sampled_from([0.0, 0.9, 1.0]),
)
def test_any_map(
    core: Core, seed: int, side: int, kept: int, gain: float, size: float, speed: float, sees: float
) -> None:
    """`sees`: the share of the residual that the map knows."""
    rng, both = np.random.default_rng(seed), Both(core, VersionTestConfig(misfit_floor=(0.5, 0.5)), side)
    source = channel(seed, (9, 5), gain)
    features, ours = NetworkFeatures(source), c_network_features(core, source)
    theta, recent = size * source.last_layer, signals(seed, kept)
    now = signals(seed + 1, 1)[0]
    now[SIGNAL_INDEX["velocity_n"] :][:3] = speed * rng.normal(size=3)
    residuals = sees * (theta.T @ features.evaluate(features.select(recent.T))).T + (1.0 - sees) * rng.normal(
        size=(kept, 3)
    )
    both.refusal(ours, features, theta, now, recent, residuals)
    both.still_good(ours, features, theta, now)


CLIFFS = [
    (0.2, 190.0, 40.0, "reach"),
    (0.2, 190.0, 4.0, "slope"),
    (0.2, 0.5, 4.0, ""),
    (9.0, 190.0, 4.0, ""),
]


@pytest.mark.parametrize(("at", "sharp", "height", "refusal"), CLIFFS)
def test_a_cliff_ahead(core: Core, at: float, sharp: float, height: float, refusal: str) -> None:
    source, both = cliff(at, sharp, height), Both(core, VersionTestConfig(), 0)
    now = np.zeros(SIGNAL_COUNT)
    now[SIGNAL_INDEX["velocity_n"]] = 1.0
    recent = np.repeat(now[None], 5, axis=0)
    features, ours = NetworkFeatures(source), c_network_features(core, source)
    assert both.refusal(ours, features, source.last_layer, now, recent, np.zeros((5, 3))) == refusal
    for place in (0.0, 4.0, 8.7):
        now[SIGNAL_INDEX["position_n"]] = place
        both.still_good(ours, features, source.last_layer, now)


def test_all_refusals_occur(core: Core) -> None:
    """Of a smooth map: too far from what was measured, too high, too steep, and good."""
    found, now = set(), np.zeros(SIGNAL_COUNT)
    recent = np.zeros((4, SIGNAL_COUNT))
    for size, gain, residual in ((0.1, 0.2, 0.0), (9.0, 0.2, 0.0), (9.0, 0.2, None), (3.0, 5.0, None)):
        source = version(1, size, gain).position
        features, ours = NetworkFeatures(source), c_network_features(core, source)
        measured = (source.last_layer.T @ features.evaluate(features.select(recent.T))).T
        residuals = measured if residual is None else np.full((4, 3), residual)
        both = Both(core, VersionTestConfig(spread_max=(1e3, 1e3)), 0)
        found.add(both.refusal(ours, features, source.last_layer, now, recent, residuals))
    assert found == {"", "misfit", "reach", "slope"}


def test_the_bias_alone_has_no_slope(core: Core) -> None:
    both, ours = Both(core, VersionTestConfig(), 1), core.Features()
    core.features_init_bias(ours)
    now = signals(3, 1)[0]
    both.refusal(ours, BiasFeatures(), np.full((1, 3), 2.0), now, signals(4, 6), np.ones((6, 3)))
    assert both.theirs.found[3] == 0.0


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_numbers_that_are_not_finite(core: Core, bad: float) -> None:
    """Of a state, of the map: both answer alike."""
    source, both = version(2, 0.3).position, Both(core, VersionTestConfig(), 0)
    features, ours = NetworkFeatures(source), c_network_features(core, source)
    now, recent, residuals = signals(5, 1)[0], signals(6, 5), np.zeros((5, 3))
    theta = source.last_layer.copy()
    for target, place in ((now, 0), (recent, (2, 1)), (residuals, (1, 1)), (theta, (1, 2))):
        kept, target[place] = target[place], bad
        with np.errstate(invalid="ignore"):
            expected = both.theirs.refusal(features, theta, now, recent.T, residuals)
        states = array(core, theta), array(core, now), array(core, recent), array(core, residuals)
        assert REFUSALS[core.version_test_refusal(both.ours, ours, *states, 5)] == expected
        with np.errstate(invalid="ignore"):
            both.look(ours, features, theta, now)
        target[place] = kept


def test_the_shipped_limits(core: Core) -> None:
    """The settings that fly, on maps about their limits."""
    config = shipped_controller("dmrac")._settings.guard.test
    both, found = Both(core, config, 0), set()
    for seed in range(40):
        source = version(seed, 0.1 * seed, 0.5 * (seed % 7)).position
        features, ours = NetworkFeatures(source), c_network_features(core, source)
        recent = signals(seed, 30, 0.3)
        measured = (source.last_layer.T @ features.evaluate(features.select(recent.T))).T
        found.add(both.refusal(ours, features, source.last_layer, recent[0], recent, measured))
    assert {"", "slope"} <= found
