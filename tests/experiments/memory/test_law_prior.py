"""S0 of a memory is the prior of the law that flew, and has no value of its own."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from configs.parts import part_names, read_part
from experiments.flights.scenario import Choices, resolve
from experiments.memory.law_prior import Spreads, default_spreads, law_spreads
from experiments.memory.learning import Source, learn_from
from offboard.memory.config import MemoryConfig
from offboard.memory.memory import Memory
from tests.offboard.memory.conditions import FEATURES, condition, random_prior

NOTHING = MemoryConfig(steps=0)


def flown(name: str, spreads: Spreads | None) -> Source:
    return Source(Path(name), FEATURES, (condition(name, jet=1.0, seed=len(name)),), None, spreads)


def test_the_spreads_are_those_of_the_law_on_board() -> None:
    sets = (
        "onboard.controller.settings.position.augmentation.law.prior=0.7",
        "onboard.controller.settings.attitude.augmentation.law.prior=2.5",
    )
    config = resolve("hover", Choices("dmrac", assignments=sets))
    assert law_spreads(config.onboard.controller.settings) == Spreads(0.7, 2.5)
    settings: Any = resolve("hover", Choices("dmrac")).onboard.controller.filled_settings(config.features)
    priors = tuple(one.augmentation.law.prior for one in (settings.position, settings.attitude))
    assert default_spreads() == priors


@pytest.mark.parametrize("name", [name for name in part_names("controllers") if name != "dmrac"])
def test_a_law_without_a_prior_says_nothing(name: str) -> None:
    assert law_spreads(read_part("controllers", name)["settings"]) is None


@pytest.mark.parametrize("prior", [0, -1.0, "much", None, {"value": 1.0}])
def test_a_prior_that_is_no_positive_number_says_nothing(prior: Any) -> None:
    law = {"augmentation": {"law": {"prior": 1.0}}}
    assert law_spreads({"position": law, "attitude": law}) == Spreads(1.0, 1.0)
    assert law_spreads({"position": law, "attitude": {"augmentation": {"law": {"prior": prior}}}}) is None


def test_the_last_flight_with_a_prior_counts() -> None:
    sources = [flown("a", Spreads(0.5, 2.0)), flown("bb", Spreads(0.4, 1.5)), flown("ccc", None)]
    np.testing.assert_allclose(learn_from(sources, NOTHING).prior.variance, [0.16, 2.25])
    alone = learn_from([flown("a", None)], NOTHING)
    np.testing.assert_allclose(alone.prior.variance, np.square(default_spreads()))


def test_a_memory_keeps_its_own_until_a_flight_says_otherwise() -> None:
    from experiments.memory.learning import _of_memory

    prior = replace(random_prior(), variance=np.array([0.09, 4.0]))
    memory = Memory(FEATURES, prior, (condition("jet", jet=1.0),), 1)
    source = _of_memory(Path("m"), memory)
    assert source.spreads == pytest.approx(Spreads(0.3, 2.0))
    assert _of_memory(Path("m"), replace(memory, learnt=0)).spreads is None
    np.testing.assert_allclose(learn_from([source, flown("a", None)], NOTHING).prior.variance, [0.09, 4.0])
    np.testing.assert_allclose(
        learn_from([source, flown("a", Spreads(0.5, 2.5))], NOTHING).prior.variance, [0.25, 6.25]
    )
