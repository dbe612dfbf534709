"""Every example runs as a notebook, in any folder, and prints what its text promises."""

import re
from pathlib import Path

import jupytext
import pytest
from nbclient import NotebookClient

pytestmark = pytest.mark.timeout(1200)  # whole flights, and the compilation of a class of one's own
EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def run(name: str, folder: Path) -> str:
    """The text that the cells print, run by a kernel of its own in the folder."""
    notebook = jupytext.read(EXAMPLES / f"{name}.py")
    NotebookClient(notebook, kernel_name="python3", resources={"metadata": {"path": str(folder)}}).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    text = "".join(output.text for output in outputs if output.output_type == "stream" and output.name == "stdout")
    print(text)  # for a failure's report
    return text


def rmse(text: str) -> dict[str, float]:
    """Position RMSE, m, by the first word of its line."""
    found = re.findall(r"^(\w+)?.*position RMSE ([\d.]+) m", text, flags=re.MULTILINE)
    return {name: float(value) for name, value in found}


def test_all_examples_are_run_here() -> None:
    tested = {name.removeprefix("test_example_") for name in globals() if name.startswith("test_example_")}
    assert tested == {path.stem for path in EXAMPLES.glob("*.py")}


def test_example_first_flight(tmp_path: Path) -> None:
    text = run("first_flight", tmp_path)
    assert rmse(text)["dmrac"] < rmse(text)["pid"]
    assert (tmp_path / "first_flight/dmrac.png").stat().st_size > 10_000


def test_example_my_controller(tmp_path: Path) -> None:
    text = run("my_controller", tmp_path)
    assert "alive: True" in text
    assert next(iter(rmse(text).values())) < 0.2


def test_example_my_disturbance(tmp_path: Path) -> None:
    text = run("my_disturbance", tmp_path)
    assert rmse(text)["l1"] < rmse(text)["none"]
    assert all(float(force) > 0.07 for force in re.findall(r"largest force ([\d.]+) N", text))


def test_example_learn_from_a_log(tmp_path: Path) -> None:
    text = run("learn_from_a_log", tmp_path)
    mean, trained, on_line = map(float, re.findall(r"(?:mean|map|on line) ([\d.]+)", text))
    assert on_line < trained < mean
    assert "swap: done" in text


def test_example_gymnasium_agent(tmp_path: Path) -> None:
    text = run("gymnasium_agent", tmp_path)
    rewards = [float(value) for value in re.findall(r"mean reward of a step (-?[\d.]+)", text)]
    assert rewards[-1] > rewards[0] + 0.05
    assert set(rmse(text)) == {"agent", "dmrac"}
    assert text.count("alive: True") == 2


def test_example_reproduce_a_table(tmp_path: Path) -> None:
    text = run("reproduce_a_table", tmp_path)
    assert "6 flights, " in text
    assert "0 could not be flown" in text
    rows = re.findall(r"^\| 0\.7 \| (\S+) \| (\d+) \| (\d+) %", text, flags=re.MULTILINE)
    assert [(name.strip("*"), flights) for name, flights, _ in rows] == [("none", "2"), ("pid", "2"), ("dmrac", "2")]
    assert rows[2][2] == "100"
