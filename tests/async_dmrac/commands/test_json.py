"""Every command that prints a table also prints JSON: all of it on standard output, and nothing else there."""

import argparse
import json
from pathlib import Path

import pytest

from async_dmrac.command_line import SUBCOMMANDS, build_parser, main

NO_TABLE = {
    "config": "prints a configuration file",
    "keygen": "prints one line",
    "campaign": "prints one line; the rows are in a Parquet file",
    "figures": "writes a page",
    "reproduce": "writes a page",
    "view": "shows a flight",
    "report": "writes a page",
    "completion": "prints a script",
    "core": "prints one line for each library",
    "mambo": "prints lines; the certificate of the check is a JSON file",
}
"""The commands without `--json`, and why. A new command has the option, or stands here."""


def with_actions(name: str) -> list[argparse.ArgumentParser]:
    """The parser of a subcommand, or those of its actions that print a table."""
    [subparsers] = [one for one in build_parser(name)._actions if isinstance(one, argparse._SubParsersAction)]
    parser = subparsers.choices[name]
    below = [one for one in parser._actions if isinstance(one, argparse._SubParsersAction)]
    return [below[0].choices[key] for key in below[0].choices if key not in ("merge", "export")] if below else [parser]


@pytest.mark.parametrize("name", sorted(SUBCOMMANDS.keys() - NO_TABLE.keys()))
def test_a_command_that_prints_a_table_has_the_option(name: str) -> None:
    for parser in with_actions(name):
        [option] = [one for one in parser._actions if "--json" in one.option_strings]
        assert option.nargs == 0, "a flag: the JSON goes to standard output"


@pytest.mark.parametrize("name", sorted(NO_TABLE))
def test_a_command_without_the_option_builds_no_table(name: str) -> None:
    source = Path(str(__import__(SUBCOMMANDS[name].module, fromlist=["x"]).__file__)).read_text(encoding="utf-8")
    assert "rich.table" not in source
    assert "--json" not in build_parser(name).format_help()


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("flown") / "flight"
    assert main(["fly", "hover", "--controller", "pid", "--lockstep", "--duration", "6", "--out", str(folder)]) == 0
    return folder


@pytest.mark.parametrize(
    ("words", "key"),
    [
        ("fly hover --controller pid --lockstep --duration 6 --json", "position_rmse_m"),
        ("replay FLIGHT --json", "replayed"),
        ("replay FLIGHT --check --json", "equal"),
        ("log info FLIGHT --json", "topics"),
        ("log check FLIGHT --json", "faults"),
        ("compare FLIGHT FLIGHT --json", "flights"),
        ("doctor --json", "remedy"),
        ("modes --json", "4"),
        ("demo --duration 6 --json", "flights"),
    ],
)
def test_standard_output_is_json(
    words: str,
    key: str,
    flight: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(words.replace("FLIGHT", str(flight)).split()) in (0, 1)
    found = json.loads(capfd.readouterr().out, parse_constant=pytest.fail)
    assert key in (found[0] if isinstance(found, list) else found)
