"""The trainer's options --memory and --remember."""

import argparse
from pathlib import Path

import pytest

from configs.loader import ConfigError
from offboard import command
from offboard.memory.folder import open_memory, write_memory
from offboard.memory.memory import Memory
from tests.offboard.memory.conditions import FEATURES, condition, random_prior


def vehicles(tmp_path: Path, *words: str) -> list[command.Vehicle]:
    parser = argparse.ArgumentParser()
    command.add_arguments(parser)
    always = ["--onboard", "127.0.0.1:14999", "--out", str(tmp_path / "out")]
    return command._vehicles(parser.parse_args([*always, *words]))


def test_a_trainer_starts_from_a_memory_and_adds_its_flight(tmp_path: Path) -> None:
    folder = tmp_path / "memory"
    write_memory(folder, Memory(FEATURES, random_prior(), (condition("jet", jet=1.0),), 1))
    (vehicle,) = vehicles(tmp_path, "--memory", str(folder), "--remember")
    assert vehicle.core.learner._memory is not None
    assert command._remember(vehicle)
    assert [one.name for one in open_memory(folder).conditions] == ["jet"]  # a flight without samples adds nothing


def test_a_trainer_begins_a_memory(tmp_path: Path) -> None:
    (vehicle,) = vehicles(tmp_path, "--memory", str(tmp_path / "new"), "--remember")
    assert vehicle.core.learner.latest is None
    assert command._remember(vehicle)
    assert open_memory(tmp_path / "new").conditions == ()


def test_a_damaged_memory_does_not_stop_the_others(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (vehicle,) = vehicles(tmp_path, "--memory", str(tmp_path / "new"), "--remember")
    (tmp_path / "new").mkdir()
    (tmp_path / "new" / "memory.npz").write_bytes(b"rubbish")
    assert not command._remember(vehicle)
    assert "the flight cannot be added" in capfd.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--remember"], "--remember: only with --memory FOLDER"),
        (["--memory", "nothing"], "memory nothing: nothing: cannot be read"),
        (["--memory", "m", "--remember", "--warm-start", "f.npz"], "--warm-start f.npz: not allowed with the memory m"),
    ],
)
def test_options_that_do_not_fit(words: list[str], message: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=message):
        vehicles(tmp_path, *words)
