"""`dmrac learn`, `dmrac memory show`, and a flight that starts from what they made."""

import json
from pathlib import Path

import numpy as np
import pytest

from async_dmrac.command_line import main
from experiments.memory.law_prior import Spreads, default_spreads
from experiments.memory.learning import learnt_from_lessons, lesson, read_source
from offboard.memory.config import MemoryConfig
from offboard.memory.folder import open_memory, remember, write_memory
from offboard.memory.memory import Memory
from offboard.memory.memory_file import load_memory
from tests.offboard.memory.conditions import FEATURES, condition, random_prior

FLY = ["fly", "lissajous_wind", "--lockstep", "--duration", "9"]


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A flight without a trainer."""
    out = tmp_path_factory.mktemp("flights") / "first"
    assert main([*FLY, "--controller", "l1", "--seed", "4", "--out", str(out)]) == 0
    return out


def test_a_flight_becomes_a_memory_from_which_another_starts(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    memory = tmp_path / "memory"
    assert main(["learn", str(flight), "--out", str(memory), "--steps", "5"]) == 0
    made = capsys.readouterr().out
    assert "1 conditions" in made
    assert "lissajous_wind, l1, seed 4" in made
    assert main(["memory", "show", str(memory)]) == 0
    assert capsys.readouterr().out == made
    out = tmp_path / "second"
    assert main([*FLY, "--seed", "5", "--memory", str(memory), "--remember", "--out", str(out)]) == 0
    assert len(open_memory(memory).conditions) == 2
    np.testing.assert_allclose(open_memory(memory).prior.variance, np.square(default_spreads()))
    summary = json.loads((out / "summary.json").read_text())
    assert str(memory) in summary["command"]


def test_merging_counts_a_flight_once(flight: Path, tmp_path: Path) -> None:
    first, second, both = (tmp_path / name for name in ("first", "second", "both"))
    write_memory(second, Memory(FEATURES, random_prior(), (condition("jet", jet=1.0),), 1))
    assert main(["learn", str(flight), "--out", str(first), "--steps", "2"]) == 0
    assert main(["learn", str(first), str(second), str(flight), "--out", str(both), "--steps", "2"]) == 0
    assert len(open_memory(both).conditions) == 2


def test_lessons_of_a_campaign_make_a_memory(flight: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("experiments.memory.learning.MemoryConfig", lambda: MemoryConfig(steps=2))
    from experiments.replays.recorded_flight import read_recorded

    recorded = read_recorded(flight)
    assert recorded.trace is not None
    alone = lesson(recorded.config, recorded.trace)
    assert load_memory(alone).learnt == 0
    taught = load_memory(learnt_from_lessons((alone,), Spreads(0.5, 2.0)))
    assert taught.learnt == 1
    np.testing.assert_allclose(taught.prior.variance, [0.25, 4.0])
    assert taught.conditions[0].digest == read_source(flight).conditions[0].digest


def test_a_trainer_begins_a_memory_and_adds_to_it(tmp_path: Path) -> None:
    folder = tmp_path / "memory"
    for number in range(2):
        remember(folder, condition(f"flight {number}", jet=1.0, seed=number), FEATURES)
    memory = open_memory(folder)
    assert [one.name for one in memory.conditions] == ["flight 0", "flight 1"]
    assert memory.learnt == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("learn nothing --out m", "nothing: no such flight"),
        ("learn empty --out m", "empty: contains no flight log"),
        ("learn rubbish --out m", "memory rubbish: not a memory, or damaged"),
        ("learn empty --out m --steps -1", "--steps -1 --seed 1: allowed are 0 to 100000, and 0 or more"),
        ("memory show nothing", "memory nothing: nothing: cannot be read: No such file or directory"),
        ("memory show rubbish", "memory rubbish: not a memory, or damaged"),
        ("fly hover --lockstep --memory nothing", "memory nothing: nothing: cannot be read"),
        ("fly hover --lockstep --remember", "--remember: only with --memory FOLDER"),
        ("fly hover --set offboard.experience.remember=true", "remember: true needs memory"),
    ],
)
def test_bad_sources_are_one_line(
    words: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    (tmp_path / "rubbish").mkdir()
    (tmp_path / "rubbish" / "memory.npz").write_bytes(b"rubbish")
    assert main(words.split()) == 2
    captured = capsys.readouterr()
    assert message in captured.err
    assert captured.err.count("\n") == 1
    assert not (tmp_path / "m").exists()
