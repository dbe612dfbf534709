"""Every command that README and docs show is one that exists: its words are parsed, and the cheap ones run.

The flights, campaigns and live processes among them are run by the tests of their packages.
"""

import argparse
import os
import re
import shlex
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from experiments.command_line import SUBCOMMANDS, build_parser, main

ROOT = Path(__file__).resolve().parents[1]
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
START = r"(?:\.venv/bin/dmrac|dmrac|scripts/[a-z_]+)"
NO_ARGUMENTS = {"scripts/test", "scripts/environment"}
"""Scripts that are no subcommands of `dmrac`; scripts/replay_dropouts is `dmrac dropouts`."""
PLACEHOLDERS = {"N": "3", "S": "20", "HOST:PORT": "127.0.0.1:14600", "GROUND:14550": "127.0.0.1:14550"}
OPEN_END = {"...", "…", "[...]"}


def text_of(page: Path) -> str:
    """The page without its continued lines."""
    return re.sub(r"\\\n\s*", " ", page.read_text(encoding="utf-8"))


def block_commands(page: Path) -> Iterator[str]:
    """Whole commands: lines of fenced or indented code, without prompt and comment."""
    for line in text_of(page).splitlines():
        if line.startswith("|"):  # a table's cells are prose; their commands stand in backticks
            continue
        for part in re.split(r"(?:&&|\||\s&)\s", line):
            found = re.match(rf"^\s*(?:\$ )?({START}(?:\s.*)?)$", part)
            if found and "`" not in part:
                yield found.group(1)


def inline_commands(page: Path) -> Iterator[str]:
    """Commands in running text, which may leave arguments out."""
    text = re.sub(r"^```.*?^```", "", text_of(page), flags=re.MULTILINE | re.DOTALL)
    for quoted in re.findall(r"(?<!`)`([^`]+)`(?!`)", text):
        if re.fullmatch(rf"{START}(?:\s.*)?", quoted, flags=re.DOTALL):
            yield " ".join(quoted.split())


def words_of(command: str) -> list[str]:
    """The arguments of `dmrac` that a command stands for; empty for scripts that are not `dmrac`."""
    program, *words = shlex.split(command, comments=True)
    if program in NO_ARGUMENTS:
        return []
    if program.startswith("scripts/"):
        assert (ROOT / program).is_file(), f"{command}: there is no {program}"
        assert os.access(ROOT / program, os.X_OK), f"{program} cannot be run"
        name = program.removeprefix("scripts/")
        words = ["dropouts" if name == "replay_dropouts" else name, *words]
    return [PLACEHOLDERS.get(word.strip("[]"), word.strip("[]")) for word in words if word not in OPEN_END]


@cache
def parser_of(name: str) -> argparse.ArgumentParser:
    return build_parser(name)


def parse(words: list[str]) -> None:
    """Parse; --help is an answer too."""
    try:
        parser_of(words[0]).parse_args(words)
    except SystemExit as end:
        if end.code:
            pytest.fail(f"dmrac {shlex.join(words)}: the command line does not take this")


def pages_with(commands: dict[Path, list[str]]) -> list[tuple[Path, str]]:
    return [(page, command) for page, found in commands.items() for command in dict.fromkeys(found)]


BLOCKS = pages_with({page: list(block_commands(page)) for page in PAGES})
INLINE = pages_with({page: list(inline_commands(page)) for page in PAGES})


def test_there_are_commands_to_look_at() -> None:
    assert len(BLOCKS) > 20
    assert len(INLINE) > 20


@pytest.mark.parametrize(("page", "command"), BLOCKS, ids=[f"{page.name}: {command}" for page, command in BLOCKS])
def test_a_shown_command_is_taken(page: Path, command: str) -> None:
    words = words_of(command)
    if words and words[0] != "--help":
        assert words[0] in SUBCOMMANDS, f"{page.name}: {command}"
        parse(words)


@pytest.mark.parametrize(("page", "command"), INLINE, ids=[f"{page.name}: {command}" for page, command in INLINE])
def test_a_mentioned_command_has_its_options(page: Path, command: str) -> None:
    names, options = [], []
    for word in words_of(command):
        (options if word.startswith("--") else names).append(word.partition("=")[0])
    if not names:
        return
    assert names[0] in SUBCOMMANDS, f"{page.name}: {command}"
    parser = parser_of(names[0])
    for name in names:  # down into `log info` and the like
        for action in parser._actions:
            if isinstance(action, argparse._SubParsersAction) and name in action.choices:
                parser = action.choices[name]
    for option in options:
        assert option in parser._option_string_actions, f"{page.name}: {command}: no {option}"


def cheap(command: str) -> bool:
    """Whether a command takes a moment and needs nothing but this checkout."""
    return words_of(command)[:1] in (["config"], ["keygen"]) or "--help" in command


CHEAP = list(dict.fromkeys(command for _, command in BLOCKS if cheap(command)))


@pytest.mark.parametrize("command", CHEAP)
def test_a_cheap_command_runs(command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    if "key_file=" in command:
        assert main(["keygen", "flight.key"]) == 0
    try:
        status = main(words_of(command))
    except SystemExit as end:  # --help
        status = int(end.code or 0)
    assert status == 0
