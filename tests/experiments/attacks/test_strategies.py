"""The family of bad learners that the optimiser searches: what its parameters do, and the file of its finds."""

import json

import numpy as np
import pytest

from configs.loader import ConfigError
from experiments.attacks.attack_flight import AttackFlight
from experiments.attacks.bad_learner import View, _tests
from experiments.attacks.cases import CASES
from experiments.attacks.strategies import FINDS, RANGES, checked, read_finds, strategy_case
from experiments.flights.scenario import Choices, resolve
from onboard.control.features import NetworkFeatures
from protocol.signals import SIGNAL_COUNT, SIGNAL_INDEX

PLAIN = {name: 0.0 if low < 0.0 else low for name, (low, _, _) in RANGES.items()} | {"share": 1.0, "alternate": 1.0}
CONFIG = resolve(AttackFlight("search", 1).scenario, Choices("dmrac"))


def view(time_s=5.0):
    """A second on a circle, with a nu_ad that depends on the place."""
    n = 60
    angle = 2.0 * np.pi * np.arange(n) / 50.0 / 4.0
    signals = np.zeros((n, SIGNAL_COUNT))
    for name, value in (
        *(("position_n", np.cos(angle)), ("position_e", np.sin(angle)), ("position_d", -1.0)),
        *(("velocity_n", -np.sin(angle)), ("velocity_e", np.cos(angle))),
    ):
        signals[:, SIGNAL_INDEX[name]] = value
    adaptive = np.zeros((n, 2, 3))
    adaptive[:, 0, 0], adaptive[:, 1, 1] = np.sin(angle), 10.0 * np.cos(angle)
    return View(
        CONFIG.features.trained, (40.0, 250.0), _tests(CONFIG), np.random.default_rng(1), time_s, signals, adaptive
    )


def made(strategy, seen=None):
    seen = view() if seen is None else seen
    channels = strategy_case(checked(strategy, "test"), 4.5)(seen)
    assert channels is not None
    return channels


def nu(channel, signals):
    features = NetworkFeatures(channel)
    return channel.last_layer.T @ features.evaluate(features.select(signals.T))


@pytest.mark.parametrize("part", ["honest", "place", "place_swirl", "motion", "motion_swirl", "step", "across"])
def test_every_mixture_is_as_large_as_is_accepted_and_no_larger(part):
    seen = view()
    strategy = PLAIN | {f"position_{part}": -1.0, f"attitude_{part}": 1.0, "step_ahead_m": 0.3, "step_sharpness": 5.0}
    for name, channel in zip(("position", "attitude"), made(strategy, seen), strict=True):
        assert np.linalg.norm(channel.last_layer) > 0.0
        assert seen.is_accepted(name, channel)


def test_a_share_scales_it():
    whole, half = (made(PLAIN | {"position_along": 1.0, "share": share})[0] for share in (1.0, 0.5))
    np.testing.assert_allclose(half.last_layer, 0.5 * whole.last_layer)


def test_the_honest_part_is_what_was_flown_and_its_opposite():
    seen = view()
    for weight in (1.0, -1.0):
        flown = nu(made(PLAIN | {"position_honest": weight}, view())[0], seen.signals[-50:])[0]
        assert np.corrcoef(flown, seen.adaptive[-50:, 0, 0])[0, 1] * weight > 0.95


def test_a_slope_over_the_place_pushes_away_and_a_swirl_across():
    seen = view()
    moved = np.repeat(seen.signals[-1:], 2, axis=0)
    moved[1, SIGNAL_INDEX["position_n"]] += 0.05
    along, swirl = (
        np.diff(nu(made(PLAIN | {name: 1.0}, view())[0], moved), axis=1)[:, 0]
        for name in ("position_place", "position_place_swirl")
    )
    assert along[0] > 0.0
    assert abs(along[1]) < 1e-6 * along[0]
    assert abs(swirl[1]) > 0.0
    assert abs(swirl[0]) < 1e-6 * abs(swirl[1])


def test_versions_come_when_the_strategy_says_so_and_change_sign():
    case = strategy_case(checked(PLAIN | {"delay_s": 0.5, "period_s": 1.0, "alternate": -1.0}, "test"), 4.5)
    assert case(view(4.9)) is None
    assert case(view(5.1)) is not None
    later = view(5.9)
    later.sent = 1
    assert case(later) is None
    first, second = (made(PLAIN | {"position_along": 1.0, "alternate": -1.0}, one) for one in (view(9.0), view(9.0)))
    np.testing.assert_array_equal(first[0].last_layer, second[0].last_layer)
    seen = view(9.0)
    seen.sent = 1
    turned = made(PLAIN | {"position_along": 1.0, "alternate": -1.0}, seen)
    assert float(np.vdot(turned[0].last_layer, first[0].last_layer)) < 0.0


def test_the_finds_of_the_corpus_are_whole_and_flown_as_cases():
    finds = read_finds()
    names = [name for name in CASES if name == "search" or name.startswith("search_")]
    assert len(names) == len(finds) > 0
    assert json.loads(FINDS.read_text())["command"].startswith("dmrac attack --search")


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"share": 1.5}, "share: 1.5 is not between 0.2 and 1.0"),
        ({"share": "much"}, "share"),
        ({"other": 1.0}, "other"),
    ],
)
def test_a_wrong_find_is_named(tmp_path, changed, message):
    path = tmp_path / "finds.json"
    path.write_text(json.dumps({"command": "", "finds": [{"strategy": PLAIN | changed}]}))
    with pytest.raises(ConfigError, match=message):
        read_finds(path)


@pytest.mark.parametrize("content", ["", "[]", "{}", '{"finds": [{}]}'])
def test_another_file_is_a_plain_error(tmp_path, content):
    path = tmp_path / "finds.json"
    path.write_text(content)
    with pytest.raises(ConfigError, match="finds"):
        read_finds(path)
