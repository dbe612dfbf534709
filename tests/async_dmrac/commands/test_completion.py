"""The completion scripts, tried in bash."""

import shutil
import subprocess
from pathlib import Path

import pytest

from async_dmrac.command_line import SUBCOMMANDS, main
from async_dmrac.commands.completion import SHELLS

pytest.importorskip("shtab")
ASK = """source ./script
COMP_WORDS=({words})
COMP_LINE="${{COMP_WORDS[*]}}"
COMP_CWORD=$((${{#COMP_WORDS[@]}} - 1))
$(complete -p dmrac | sed 's/.*-F \\([^ ]*\\) .*/\\1/')
printf '%s\\n' "${{COMPREPLY[@]}}"
"""


@pytest.fixture(scope="module")
def script(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("completion")


def completed(folder: Path, words: str, capsys: pytest.CaptureFixture[str]) -> set[str]:
    if not (folder / "script").exists():
        assert main(["completion", "bash"]) == 0
        (folder / "script").write_text(capsys.readouterr().out, encoding="utf-8")
    command = ["bash", "-c", ASK.format(words=words)]
    result = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True, timeout=60)
    return set(result.stdout.split())


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash")
@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("dmrac ''", set(SUBCOMMANDS)),
        ("dmrac fly figure8_w", {"figure8_wind"}),
        ("dmrac fly --controller dm", {"dmrac"}),
        ("dmrac campaign wind_f", {"wind_figure8"}),
        ("dmrac log ex", {"export"}),
        ("dmrac fly --lock", {"--lockstep"}),
    ],
)
def test_bash_completes(words: str, expected: set[str], script: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert completed(script, words, capsys) == expected


@pytest.mark.parametrize("shell", SHELLS)
def test_every_shell_gets_a_script(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", shell]) == 0
    assert "figure8_wind" in capsys.readouterr().out
