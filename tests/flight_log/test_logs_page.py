"""The commands and the Python code in docs/logs.md run on a flight."""

import re
import shlex
from pathlib import Path

import pytest

from async_dmrac import command_line

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "logs.md").read_text(encoding="utf-8")
COMMANDS = re.findall(r"^\$ scripts/(.+)$", PAGE, flags=re.MULTILINE)


@pytest.mark.parametrize("command", [line for line in COMMANDS if not line.startswith("view")])
def test_the_commands_run(command: str, full_flight: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert command_line.main([str(full_flight) if word == "FLIGHT" else word for word in shlex.split(command)]) == 0


def test_the_python_runs(full_flight: Path, capsys: pytest.CaptureFixture[str]) -> None:
    [text] = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
    exec(text.replace("FLIGHT", str(full_flight)), {})
    assert capsys.readouterr().out.splitlines() == ["m 0.10000008344650269 mode FLYING <fast>", "0.123456 () ()"]
