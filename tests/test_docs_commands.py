"""Everything that the documentation names exists: commands, options, pictures, paths, links and tests."""

import argparse
import re
import shlex
from fnmatch import fnmatch
from functools import cache
from pathlib import Path

import pytest

from async_dmrac.command_line import SUBCOMMANDS, build_parser
from tests.docs_commands import BLOCKS, INLINE, PAGES, ROOT, inline_code, words_of

PACKAGES = (
    *("async_dmrac", "configs", "experiments", "flight_log", "mambo", "offboard", "onboard", "protocol", "runtime"),
    *("sim_vehicle", "tests"),
)
FROM_ROOT = (*(f"{name}/" for name in (*PACKAGES, "docs", "scripts", ".ci", ".github")), "README", "pyproject")
NAMED = re.compile(r"[\w.*-]+(?:/[\w.*-]+)*/?")
SOURCES = {
    f"/{path.relative_to(ROOT)}": path.read_text(encoding="utf-8")
    for name in PACKAGES
    for path in (ROOT / name).rglob("*.py")
}
TESTS = set(re.findall(r"^def (test_\w+)", "\n".join(SOURCES.values()), flags=re.MULTILINE))
TOPICS = set(
    re.findall(r'"((?:onboard|offboard|sim_vehicle|flight)/\w+|async_dmrac/Mambo-v\d)"', "\n".join(SOURCES.values()))
)
"""Of records in a flight log, and the environment; they look like paths."""

parser_of = cache(build_parser)


def test_the_documentation_shows_commands() -> None:
    assert len(BLOCKS) > 20
    assert len(INLINE) > 20


@pytest.mark.parametrize(("page", "command"), BLOCKS, ids=lambda value: getattr(value, "name", value))
def test_a_shown_command_parses(page: Path, command: str) -> None:
    words = words_of(command)
    if not words or words[0] == "--help":
        return
    assert words[0] in SUBCOMMANDS, f"{page.name}: {command}"
    try:
        parser_of(words[0]).parse_args(words)
    except SystemExit as end:  # --help ends with 0
        if end.code:
            pytest.fail(f"dmrac {shlex.join(words)}: refused by the command line")


@pytest.mark.parametrize(("page", "command"), INLINE, ids=lambda value: getattr(value, "name", value))
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


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_named_path_and_test_exists(page: Path) -> None:
    """Paths from the root, Python files by the end of their path (or shown as an example in the page), and tests."""
    text, missing = page.read_text(encoding="utf-8"), []
    for code in filter(NAMED.fullmatch, inline_code(page)):
        if code.startswith(FROM_ROOT):
            found = any(ROOT.glob(code.replace("NAME", "*").rstrip("/"))) or code in TOPICS
        elif code.endswith(".py"):
            found = any(fnmatch(path, f"*/{code}") for path in SOURCES) or f"`{code}`" in text.partition("```python")[0]
        else:
            found = not code.startswith("test_") or any(fnmatch(name, code) for name in TESTS)
        missing += [] if found else [code]
    assert not missing


def test_the_sources_name_pages_that_exist() -> None:
    for page in re.findall(r"docs/\w+\.md", "\n".join(SOURCES.values())):
        assert (ROOT / page).exists(), page


def headings(page: Path) -> set[str]:
    """The anchors of a page, as GitHub builds them."""
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    lines = re.findall(r"^#+ (.*)$", text, flags=re.MULTILINE)
    return {re.sub(r"[^\w -]", "", line.lower()).replace(" ", "-") for line in lines}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_leads_somewhere(page: Path) -> None:
    targets = re.findall(r"\]\(([^)\s]+)\)|(?:href|src)=\"([^\"]+)\"", page.read_text(encoding="utf-8"))
    for target in ("".join(pair) for pair in targets):
        if target.startswith("http"):
            continue
        name, _, anchor = target.partition("#")
        path = page.parent / name if name else page
        assert path.exists(), target
        assert not anchor or anchor in headings(path), target
        assert path.suffix != ".png" or path.read_bytes().startswith(b"\x89PNG"), target


def test_the_readme_begins_with_a_flight_and_the_table_of_results() -> None:
    first_screen = (ROOT / "README.md").read_text(encoding="utf-8").partition("\n## ")[0]
    pictures = re.findall(r'src="([^"]+)"', first_screen)
    assert [Path(picture).parent.name for picture in pictures] == ["pictures", "results"]
