"""What the commands share: the hint after Ctrl-C."""

import argparse
from pathlib import Path

import pytest

from async_dmrac.command_line import main
from async_dmrac.commands import campaign as command
from async_dmrac.commands.shared import continuing_command


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        (["campaign", "rotor_chip"], "dmrac campaign rotor_chip --resume"),
        (
            ["campaign", "a file.yaml", "--out", "x", "--seeds", "5", "--resume", "--retry-errors"],
            "dmrac campaign 'a file.yaml' --out x --seeds 5 --resume",
        ),
    ],
)
def test_the_hint_repeats_the_options(words: list[str], hint: str) -> None:
    assert continuing_command(argparse.Namespace(words=words)) == hint


def test_an_interrupted_campaign_prints_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(command, "run_campaign", interrupt)
    out = tmp_path / "flown"
    assert main(["campaign", "rotor_chip", "--seeds", "2", "--out", str(out)]) == 130
    assert f"Continue with: dmrac campaign rotor_chip --seeds 2 --out {out} --resume\n" in capsys.readouterr().out
