"""Every command that README and docs show is one that exists: its words are parsed. That they run: next file."""

import argparse
import re
import shlex
from functools import cache
from pathlib import Path

import pytest

from async_dmrac.command_line import SUBCOMMANDS, build_parser
from tests.docs_commands import BLOCKS, INLINE, PAGES, ROOT, words_of


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


def test_the_readme_begins_with_a_flight_and_the_table_of_results() -> None:
    first_screen = (ROOT / "README.md").read_text(encoding="utf-8").partition("\n## ")[0]
    pictures = re.findall(r'src="([^"]+)"', first_screen)
    assert [Path(picture).parent.name for picture in pictures] == ["pictures", "results"]


def test_the_pictures_are_there() -> None:
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        for picture in re.findall(r'!\[[^]]*(?:\[[^]]*\][^]]*)*\]\(([^)]+)\)|src="([^"]+)"', text):
            path = page.parent / "".join(picture)
            assert path.read_bytes().startswith(b"\x89PNG"), f"{page.name}: {path}"
