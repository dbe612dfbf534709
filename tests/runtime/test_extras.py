"""The parts of the installation: the table agrees with pyproject.toml, and a missing part is one clear error."""

import importlib.util
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from async_dmrac.command_line import SUBCOMMANDS, main
from runtime.extras import EXTRAS, MissingExtraError, missing_modules, require_modules

DEPENDENCIES = tomllib.loads((Path(__file__).resolve().parents[2] / "pyproject.toml").read_text(encoding="utf-8"))[
    "project"
]["optional-dependencies"]
DISTRIBUTIONS = {"foxglove": "foxglove-sdk", "mujoco": "mujoco-core", "rerun": "rerun-sdk", "sklearn": "scikit-learn"}
"""Of modules whose distribution has another name."""


@pytest.fixture
def without_torch(monkeypatch: pytest.MonkeyPatch) -> None:
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "torch" else find(name))


@pytest.mark.parametrize("extra", EXTRAS)
def test_the_table_agrees_with_the_installation(extra: str) -> None:
    declared = {re.split(r"[<>=\[]", one)[0] for one in DEPENDENCIES[extra]}
    assert {DISTRIBUTIONS.get(module, module) for module in EXTRAS[extra]} <= declared


def test_every_subcommand_needs_known_modules() -> None:
    known = {module for modules in EXTRAS.values() for module in modules}
    assert {module for one in SUBCOMMANDS.values() for module in one.modules} <= known


def test_a_missing_module_is_named_with_the_command_that_installs_it(without_torch: None) -> None:
    assert missing_modules("offboard") == ["torch"]
    with pytest.raises(MissingExtraError, match=r"not installed: torch.*pip install 'async-dmrac\[offboard\]'"):
        require_modules("numba", "torch")
    with pytest.raises(MissingExtraError, match=r"^--fast: not installed: torch"):
        require_modules("numba", "torch", purpose="--fast")


@pytest.mark.parametrize(
    "words", ["fly --lockstep", "fly", "campaign rotor_chip", "tune tune --controller pid", "demo"]
)
def test_it_is_reported_before_a_flight(
    words: str, without_torch: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(words.split()) == 2
    captured = capsys.readouterr()
    name = words.split()[0]
    assert captured.err == f"dmrac {name}: not installed: torch. Install with: pip install 'async-dmrac[offboard]'\n"
    assert captured.out == ""
    assert list(tmp_path.iterdir()) == []


def test_a_flight_without_a_trainer_needs_no_torch(without_torch: None, capsys: pytest.CaptureFixture[str]) -> None:
    """It gets as far as the folder of the record."""
    assert main(["fly", "hover", "--controller", "pid", "--lockstep", "--out", "/dev/null/x"]) == 2
    assert "--out /dev/null/x: cannot be made" in capsys.readouterr().err


BLOCKED = """
import importlib.util, sys
blocked = set(sys.argv[1].split(","))

class Block:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in blocked:
            raise ModuleNotFoundError(f"No module named {name!r} (blocked)", name=name)

sys.meta_path.insert(0, Block())
from async_dmrac.command_line import SUBCOMMANDS, build_parser

for name, subcommand in SUBCOMMANDS.items():
    if not blocked & {module.partition(".")[0] for module in subcommand.modules}:
        build_parser(name)
        print(name)
"""


@pytest.mark.parametrize("blocked", ["pyarrow", "torch,optuna,shtab", "matplotlib,sklearn,threadpoolctl"])
def test_a_command_shows_its_options_without_the_modules_that_it_does_not_need(blocked: str) -> None:
    command = [sys.executable, "-c", BLOCKED, blocked]
    result = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert result.returncode == 0, result.stderr
    assert {"fly", "log", "replay", "config", "doctor"} <= set(result.stdout.split())
