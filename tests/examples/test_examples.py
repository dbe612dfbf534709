"""Every example runs as it is shipped, from any folder, and prints what its text promises."""

import re
import runpy
from pathlib import Path

import pytest

pytestmark = pytest.mark.timeout(1200)  # whole flights, and the compilation of a class of one's own
EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def run(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> str:
    monkeypatch.chdir(folder)
    runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
    text = capsys.readouterr().out
    print(text)  # for a failure's report
    return text


def rmse(text: str) -> dict[str, float]:
    """Position RMSE, m, by the first word of its line."""
    found = re.findall(r"^(\w+)?.*position RMSE ([\d.]+) m", text, flags=re.MULTILINE)
    return {name: float(value) for name, value in found}


def test_all_examples_are_run_here() -> None:
    tested = {name.removeprefix("test_example_") for name in globals() if name.startswith("test_example_")}
    assert tested == {path.stem for path in EXAMPLES.glob("*.py")}


def test_example_first_flight(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    text = run("first_flight", tmp_path, monkeypatch, capsys)
    assert rmse(text)["dmrac"] < rmse(text)["pid"]
    assert (tmp_path / "first_flight/dmrac.png").stat().st_size > 10_000


def test_example_my_controller(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    text = run("my_controller", tmp_path, monkeypatch, capsys)
    assert "alive: True" in text
    assert next(iter(rmse(text).values())) < 0.2


def test_example_my_disturbance(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    text = run("my_disturbance", tmp_path, monkeypatch, capsys)
    assert rmse(text)["l1"] < rmse(text)["none"]
    assert all(float(force) > 0.07 for force in re.findall(r"largest force ([\d.]+) N", text))


def test_example_learn_from_a_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    text = run("learn_from_a_log", tmp_path, monkeypatch, capsys)
    mean, trained, on_line = map(float, re.findall(r"(?:mean|map|on line) ([\d.]+)", text))
    assert on_line < trained < mean
    assert "swap: done" in text


def test_example_gymnasium_agent(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    text = run("gymnasium_agent", tmp_path, monkeypatch, capsys)
    rewards = [float(value) for value in re.findall(r"mean reward of a step (-?[\d.]+)", text)]
    assert rewards[-1] > rewards[0] + 0.05
    assert set(rmse(text)) == {"agent", "dmrac"}
    assert text.count("alive: True") == 2
