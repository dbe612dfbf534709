"""Experience that one lockstep flight carries to another."""

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from configs.loader import ConfigError
from experiments.flights.carried_experience import dump_learnt, read_experience, start_from
from experiments.flights.lockstep_flight import build
from experiments.flights.scenario import Choices, resolve
from offboard.memory.folder import write_memory
from offboard.memory.memory import Memory
from offboard.memory.memory_file import FILE_NAME
from onboard.core import OnboardCore
from tests.offboard.memory.conditions import FEATURES, condition, random_prior


def cores(controller: str) -> tuple[OnboardCore, Any]:
    _, onboard, offboard, _ = build(resolve("figure8_wind", Choices(controller)))
    return onboard, offboard


def test_last_layers_of_a_controller_with_fixed_features() -> None:
    onboard, offboard = cores("mrac")
    start: Any = onboard.controller
    W = np.random.default_rng(0).normal(size=start.last_layers()[0].shape)
    start.start_from((W, None))
    again, offboard_again = cores("mrac")
    start_from(dump_learnt(onboard, offboard), again, offboard_again, frozen=False)
    other: Any = again.controller
    np.testing.assert_array_equal(other.last_layers()[0], W)
    np.testing.assert_array_equal(other.last_layers()[1], start.last_layers()[1])


def test_a_controller_that_learns_nothing_reads_and_writes_an_empty_file() -> None:
    onboard, offboard = cores("pid")
    data = dump_learnt(onboard, offboard)
    with np.load(io.BytesIO(data)) as archive:
        assert archive.files == ["position_last_layer", "attitude_last_layer"] or archive.files == []
    start_from(data, onboard, offboard, frozen=True)


def test_an_experience_that_does_not_fit_is_refused() -> None:
    mrac, offboard = cores("mrac")
    data = dump_learnt(mrac, offboard)
    bias, offboard_bias = cores("bias")
    with pytest.raises(ConfigError, match="last layer of shape"):
        start_from(data, bias, offboard_bias, frozen=False)
    dmrac, trainer = cores("dmrac")
    for frozen in (True, False):
        with pytest.raises(ConfigError, match="experience"):
            start_from(data, dmrac, trainer, frozen)  # the last layers of an MRAC contain no features
        with pytest.raises(ConfigError, match="experience"):
            start_from(b"rubbish", dmrac, trainer, frozen)
    config = resolve("hover")
    with pytest.raises(ConfigError, match="rubbish"):
        read_experience(config.model_copy(update={"experience": "/no/such/rubbish"}))
    assert read_experience(config) is None


def test_a_flight_starts_from_a_memory_or_says_why_not(tmp_path: Path) -> None:
    folder = tmp_path / "memory"
    taught = Memory(FEATURES, random_prior(), (condition("jet", jet=1.0),), 1)
    write_memory(folder, taught)
    data = read_experience(resolve("hover", Choices(assignments=[f"offboard.experience.memory={folder}"])))
    assert data is not None
    dmrac, trainer = cores("dmrac")
    start_from(data, dmrac, trainer)
    assert trainer.learner._memory is not None
    pid, relay = cores("pid")
    with pytest.raises(ConfigError, match="this controller uses none"):
        start_from(data, pid, relay)
    both = [f"offboard.experience.memory={folder}", "experience=other.npz"]
    with pytest.raises(ConfigError, match="not allowed with"):
        read_experience(resolve("hover", Choices(assignments=both)))
    (folder / FILE_NAME).write_bytes(data[:1000])
    with pytest.raises(ConfigError, match="experience: not a memory, or damaged"):
        start_from(data[:1000], dmrac, trainer)
